"""A calibration in the robot: what is written for its controller."""
