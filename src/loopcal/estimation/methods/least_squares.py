"""Least squares: the readings are exact, the squares of the loop values are minimised."""

from __future__ import annotations

from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress, solve


def _solve(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = 100,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    return solve(
        problem,
        exact=True,
        loss=loss,
        max_iterations=max_iterations,
        tolerance=tolerance,
        progress=progress,
    )


METHOD = Method(
    name="least-squares",
    label="least squares (sensors taken as exact)",
    description="Least squares: the open loops at the readings, all weighted alike; the sensors "
    "are taken as exact.",
    solve=_solve,
    exact=True,
    streamable=True,
)
