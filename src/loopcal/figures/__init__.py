"""Figures of a calibration as data for plotly; no layer above knows how they are drawn."""
