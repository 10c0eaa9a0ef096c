"""The record of a calibration: what a laboratory keeps, and its certificate."""
