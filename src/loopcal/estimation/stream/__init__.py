"""Calibration of readings that come in chunks."""
