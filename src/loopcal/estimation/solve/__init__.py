"""Solvers and the block kernel: from arrays to parameters and corrections."""
