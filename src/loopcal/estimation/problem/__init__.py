"""A calibration as arrays, and where the search for its solution begins."""
