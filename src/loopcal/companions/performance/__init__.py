"""Pose performance of robots, computed after ISO 9283: accuracy, repeatability, drift."""
