"""loopcal: calibration of mechanisms with every sensor uncertain."""
