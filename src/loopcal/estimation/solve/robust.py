"""Fits under a robust loss, and a covariance of the parameters that is valid under it.

A loss with a falling weight may have several minima, so the fit comes from above: gaussian, then
Huber's (whose cost is convex in the whitened residuals), then the loss asked for. Each stage is
the solver's own descent on the summed loss, so the end is never worse than the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.loss import Huber, Loss
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.solve.sweep import NEAR, Sweeper

Array = NDArray[np.float64]


def solve_robust(
    problem: Problem,
    loss: Loss,
    *,
    method: Method,
    max_iterations: int = 100,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The parameters of least summed loss, from the problem's start.

    The solution's spectrum and data are those of the poses as weighted at the end. Raises
    InputError as `solve` does.
    """

    def fit(start: Array, loss: Loss | None) -> Solution:
        return method.solve(
            replace(problem, start=start),
            loss=loss,
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )

    with one_blas_thread():
        found, iterations = fit(problem.start, None), 0
        for stage in dict.fromkeys([Huber(), loss]):
            iterations += found.status.iterations
            found = fit(found.parameters, stage)
        if method.likelihood and found.chi_squared > _cost(problem, loss):
            found = fit(problem.start, loss)
        total = iterations + found.status.iterations
        return replace(found, status=replace(found.status, iterations=total))


def _cost(problem: Problem, loss: Loss) -> float:
    """The summed loss at the problem's start, loops closed."""
    sweeper = Sweeper(problem, loss=loss)
    corrections = start_corrections(sweeper, problem.start)
    sweep = sweeper.sweep(problem.start, corrections, closing=NEAR)
    bad = sweep.late or sweep.singular or not sweep.finite
    return np.inf if bad else sweep.cost + problem.unknowns.prior_square(problem.start)


def robust_covariance(
    problem: Problem, solution: Solution, loss: Loss, *, at_readings: bool = False
) -> Array:
    """A^-1 B A^-1, (n, n) [SI]: A = sum a D^T D + P, B = K^2 sum b D^T D + P, P the prior's.

    a = E[div psi] / r and b = E[|psi|^2] / r, psi = w E, are means over the poses, so that the
    errors need not be gaussian; K = 1 + (n / equations) var(psi') / E[psi']^2 and division by
    equations - n correct for the parameters fitted. Huber, Robust Statistics (1981), 7.6.
    Directions that are not determined get no variance.
    """
    found = pose_equations(
        problem, solution.parameters, solution.corrections, at_readings=at_readings
    )
    n = solution.spectrum.rank
    P = np.diag(1.0 / np.square(problem.prior_sd))
    A, B = P.copy(), P.copy()
    for r in sorted({block.E.shape[1] for block in found} - {0}):
        blocks = [block for block in found if block.E.shape[1] == r]
        s = np.concatenate([np.square(block.E).sum(axis=1) for block in blocks])
        M = sum(np.einsum("bri,brj->ij", block.D, block.D) for block in blocks)
        weight = loss.weight(s, r)
        slopes = weight + 2.0 / r * loss.bend(s, r)  # d psi / d E, averaged over directions
        equations = r * len(s)
        a = float(slopes.mean())
        freedom = max(equations - n * equations / problem.equations, 1.0)
        b = float((np.square(weight) * s).sum()) / freedom
        K = 1.0 + n / problem.equations * float(slopes.var()) / a**2
        A, B = A + a * M, B + K**2 * b * M
    kept = solution.spectrum.kept
    root = solution.spectrum.scale[:, None] * solution.spectrum.directions[:, kept]
    inner = np.linalg.inv(root.T @ A @ root)
    half = root @ inner
    covariance: Array = half @ (root.T @ B @ root) @ half.T
    return covariance
