"""Residuals that depend on each other: tests of it, and a covariance that is valid under it."""
