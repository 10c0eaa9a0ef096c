"""Sds learned from the calibration itself: variance components by restricted maximum likelihood."""
