"""The undamped iteration of the thesis: the implicit loop in full Gauss-Newton steps, for study."""

from __future__ import annotations

from loopcal.estimation.methods.implicit_loop import METHOD as IMPLICIT_LOOP
from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.seed_iteration import iterate_undamped
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.solve.status import MOST_ITERATIONS


def _solve(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The iteration reports no progress, and `Fit` accepts no loss for it."""
    return iterate_undamped(problem, max_iterations=max_iterations, tolerance=tolerance)


METHOD = Method(
    name="implicit-loop-undamped",
    label="implicit loop, the undamped iteration of the thesis",
    description="Implicit loop by the undamped iteration of the thesis: every sensor is "
    "uncertain, full Gauss-Newton steps.",
    solve=_solve,
    damped=IMPLICIT_LOOP,
)
