"""Formats in which a calibrated machine goes back to where it came from."""
