"""Fits under a robust loss, and a covariance of the parameters that is valid under it.

A loss with a falling weight may have several minima, so the fit comes from above: gaussian, then
Huber's (whose cost is convex in the whitened residuals), then the loss asked for. Each stage is
the solver's own descent on the summed loss, so the end is never worse than the start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.loss import Huber, Loss
from loopcal.estimation.solve.merit import Evaluation, State
from loopcal.estimation.solve.reduction import Spectrum
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import MOST_ITERATIONS, End, Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.solve.sweep import NEAR, Sweeper


@dataclass(frozen=True)
class Stage:
    """One of the fits that lead to a robust one; earlier: iterations before it."""

    number: int = 0
    earlier: int = 0


FIRST_STAGE = Stage()


def solve_robust(
    problem: Problem,
    loss: Loss,
    *,
    method: Method,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The parameters of least summed loss, from the problem's start.

    The solution's spectrum and data are those of the poses as weighted at the end. Raises
    InputError as `solve` does.
    """

    def fit(start: Array, loss: Loss | None, stage: Stage) -> Solution:
        return method.solve(
            replace(problem, start=start),
            loss=loss,
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )

    def cost() -> float:
        merit = InMemory(Sweeper(problem, loss=loss))
        corrections = start_corrections(merit.sweeper, problem.start)
        return summed(merit.evaluate(problem.start, corrections, closing=NEAR), problem.unknowns)

    with one_blas_thread():
        return in_stages(fit, problem.start, loss, cost if method.likelihood else None)


def in_stages(
    fit: Callable[[Array, Loss | None, Stage], End[State]],
    start: Array,
    loss: Loss | None,
    cost: Callable[[], float] | None,
    begin: Stage = FIRST_STAGE,
) -> End[State]:
    """The parameters of least summed loss; a gaussian loss (None) has but one stage.

    fit: from parameters (n_all,) under a loss; cost: the summed loss at the start, None for a
    method that minimises something else; begin: the stage that an interrupted run had reached.
    """
    losses, end = [None, *dict.fromkeys([Huber(), loss] if loss else [])], None
    earlier, at = begin.earlier, start
    for number in range(begin.number, len(losses)):
        if end is not None:
            earlier, at = earlier + end.status.iterations, end.parameters
        end = fit(at, losses[number], Stage(number, earlier))
    higher = loss and cost is not None and end is not None and end.chi_squared > cost()
    if end is None or higher:
        end = fit(start, loss, Stage(len(losses), earlier))
    iterations = earlier + end.status.iterations
    return replace(end, status=replace(end.status, iterations=iterations))


def summed(evaluation: Evaluation[State], unknowns: Unknowns) -> float:
    """Loss and prior of an evaluation at the start, infinite where some loop does not close."""
    bad = evaluation.late or evaluation.singular or not evaluation.finite
    return np.inf if bad else evaluation.cost + unknowns.prior_square(unknowns.start)


@dataclass(frozen=True)
class RobustSums:
    """Sums over the poses that the covariance under a loss needs.

    by_size: for poses with r equations each their number, sum of slopes, sum of squared slopes,
    sum of w^2 |E|^2, and the sum of D^T D, (n, n) [1/SI squared].
    """

    by_size: Mapping[int, tuple[float, float, float, float, Array]]

    @classmethod
    def of(cls, problem: Problem, solution: Solution, loss: Loss) -> RobustSums:
        """The sums of some poses at a solution."""
        whole = cls({})
        for block in pose_equations(problem, solution.parameters, solution.corrections):
            r = block.rows
            if not r:
                continue
            s = np.square(block.E).sum(axis=1)
            weight = loss.weight(s, r)
            slopes = weight + 2.0 / r * loss.bend(s, r)  # d psi / d E, averaged over directions
            M = np.einsum("bri,brj->ij", block.D, block.D)
            psi = float((np.square(weight) * s).sum())
            sums = float(len(s)), float(slopes.sum()), float(np.square(slopes).sum()), psi, M
            whole = whole + cls({r: sums})
        return whole

    def __add__(self, other: RobustSums) -> RobustSums:
        by_size = dict(self.by_size)
        for r, (count, slopes, squares, psi, M) in other.by_size.items():
            left = by_size.get(r, (0.0, 0.0, 0.0, 0.0, np.zeros_like(M)))
            sums = left[0] + count, left[1] + slopes, left[2] + squares, left[3] + psi, left[4] + M
            by_size[r] = sums
        return RobustSums(by_size)

    def covariance(self, spectrum: Spectrum, prior_sd: Array) -> Array:
        """A^-1 B A^-1, (n, n) [SI]: A = sum a D^T D + P, B = K^2 sum b D^T D + P, P the prior's.

        a = E[div psi] / r and b = E[|psi|^2] / r, psi = w E, are means over the poses, so that the
        errors need not be gaussian; K = 1 + (n / equations) var(psi') / E[psi']^2 and division by
        equations - n correct for the parameters fitted. Huber, Robust Statistics (1981), 7.6.
        Directions that are not determined get no variance.
        """
        n = spectrum.rank
        P = np.diag(1.0 / np.square(prior_sd))
        A, B = P.copy(), P.copy()
        total = sum(r * sums[0] for r, sums in self.by_size.items())
        for r, (count, slopes, squares, psi, M) in sorted(self.by_size.items()):
            equations, a = r * count, slopes / count
            b = psi / max(equations - n * equations / total, 1.0)
            K = 1.0 + n / total * max(squares / count - a**2, 0.0) / a**2
            A, B = A + a * M, B + K**2 * b * M
        root = spectrum.root
        half = root @ np.linalg.inv(root.T @ A @ root)
        return half @ (root.T @ B @ root) @ half.T
