"""What a method of estimation is: how it fits, and what follows for its result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.solution import MOST_ITERATIONS, Solution
from loopcal.estimation.solve.solver import Progress


class Solve(Protocol):
    """Estimate the parameters of a problem from its start, weighted as the problem says."""

    def __call__(
        self,
        problem: Problem,
        *,
        loss: Loss | None = None,
        max_iterations: int = MOST_ITERATIONS,
        tolerance: float | None = None,
        progress: Progress | None = None,
    ) -> Solution:
        """loss: None is the gaussian one; tolerance: step [sds] that counts as converged, None is
        the method's own. Raises InputError where the loops cannot be evaluated at the start."""


@dataclass(frozen=True)
class Method:
    """One way to estimate the parameters of a mechanism.

    name: as users state it; label: for the summary; description: for the report; solve: the fit.
    weighting: what the loops count; likelihood: minimises one function of the parameters, whose
    profile is an interval; robust: accepts a loss other than the gaussian one; streamable: needs
    only sums over the poses, so they may come in chunks; damped: the method with the same optimum
    whose steps are damped, None where its own are; choice: the methods that it chooses among by
    poses not used, none where it is one by itself.
    """

    name: str
    label: str
    description: str
    solve: Solve
    weighting: Weighting = Weighting.CORRECTED
    likelihood: bool = True
    robust: bool = False
    streamable: bool = False
    damped: Method | None = None
    choice: tuple[Method, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether it takes every reading as exact: it uses neither noise nor prior, and the
        residuals scale its covariance."""
        return self.weighting is Weighting.ALIKE

    @property
    def safe(self) -> Method:
        """The method that finds this one's optimum reliably: itself if its steps are damped."""
        return self.damped or self

    def unit_variance(self, chi_squared: float, freedom: int) -> float | None:
        """Variance of a whitened equation: 1 by the stated sds, else chi-squared per degree of
        freedom; None where the residuals leave no freedom to estimate it."""
        if not self.exact:
            return 1.0
        return chi_squared / freedom if freedom > 0 else None
