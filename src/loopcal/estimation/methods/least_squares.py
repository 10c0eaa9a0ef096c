"""Least squares: the readings are exact, the squares of the loop values are minimised."""

from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.problem import Weighting
from loopcal.estimation.solve.solver import solve

METHOD = Method(
    name="least-squares",
    label="least squares (sensors taken as exact)",
    description="Least squares: the open loops at the readings, all weighted alike; the sensors "
    "are taken as exact.",
    solve=solve,
    weighting=Weighting.ALIKE,
    streamable=True,
)
