"""A machine over its life: updates of a calibration, its history, and the machines of one type."""
