"""A calibration as one typed document: the values that result.json holds, and their tables."""
