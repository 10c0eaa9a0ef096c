"""The search for the poses that do not fit: from a robust fit to a set that no longer changes.

One gross error bends a fit and hides itself and others. So the search starts from a robust fit,
leaves out what is remarkable there, fits the rest, and tests every pose against that fit, those
left out as well, until the same poses are left out twice (Rousseeuw and Leroy 1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.chi_squared import quantile
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.estimation.result import Result
from loopcal.estimation.solve.loss import Huber, Loss
from loopcal.estimation.solve.solution import Solution
from loopcal.statistics.pose_tests import Fitted, PoseTests, pose_tests, settle

Array = NDArray[np.float64]
_ROUNDS, _HOPELESS, _BENT, _REJECTED = 10, 100.0, 10.0, 1e-3


class Search:
    """The search for the set of poses that do not fit."""

    def __init__(self, result: Result, level: float, scale: str) -> None:
        self.result, self.problem = result, result.problem
        self.exact = result.fit.solver.exact
        self.level = level
        self.scale = "residual" if self.exact else scale
        names = self.problem.mechanism.tape.quantities
        aside = set(self.problem.mechanism.disturbances)
        self.readings = np.array([name not in aside for name in names])

    def hopeless(self) -> bool:
        """Whether whole columns may be wrong: a bad fit, or one that bent the machine a lot."""
        result = self.result
        chi, before, after = result.chi_squared, result.accuracy_before, result.accuracy_after
        factor = 0.0 if chi is None else chi.variance_factor or 0.0
        bent = before is not None and after is not None and before.rms > _BENT * after.rms
        rejected = chi is not None and (chi.p_value or 0.0) < _REJECTED
        bad = factor > _HOPELESS or (rejected and bent)
        return self.exact or bad or not result.status.converged

    def run(self) -> tuple[Fitted, NDArray[np.bool_], PoseTests]:
        """The last fit, the poses left out of it (N,), and the tests of all poses against it."""
        problem, result = self.problem, self.result
        none = np.zeros(len(problem.poses), dtype=bool)
        parameters = np.array([result.value[n] for n in problem.mechanism.parameters.names])
        corrections = np.array([result.corrections[q] for q in problem.mechanism.tape.quantities])
        covariance = result.spectrum.covariance()
        fit = self._scaled(Fitted(parameters, corrections, covariance, 1.0), none)
        tests = pose_tests(problem, fit, ~none, exact=self.exact)
        if result.status.converged and not self._remarkable(tests).any():
            return fit, none, tests
        fit = self._robust(fit)
        gone = self._remarkable(pose_tests(problem, fit, ~none, exact=self.exact))
        seen: list[NDArray[np.bool_]] = []
        for _ in range(_ROUNDS):
            if self._too_few(gone):
                gone = none
            fit = self._fitted(fit, gone)
            tests = pose_tests(problem, fit, ~gone, exact=self.exact)
            now = self._remarkable(tests)
            if np.array_equal(now, gone):
                break
            # a set that comes again would come for ever: the larger one errs on the safe side
            now = now | gone if any(np.array_equal(now, old) for old in seen) else now
            seen.append(gone)
            gone = now
        return fit, self._remarkable(tests), tests

    def tested(self, tests: PoseTests) -> int:
        """How many poses the tests speak of: of a stream all, for what fits badly is here."""
        return round(float((tests.freedom > 0).sum()) * self._share)

    @property
    def _share(self) -> float:
        return self.result.solution.poses / self.problem.count

    def _too_few(self, gone: NDArray[np.bool_]) -> bool:
        return bool(gone.mean() > 0.5)

    def _remarkable(self, tests: PoseTests) -> NDArray[np.bool_]:
        w = tests.w[self.readings]
        poses = 0.5 * self.level / max(self.tested(tests), 1)
        readings = 0.5 * self.level / max(float(np.isfinite(w).sum()) * self._share, 1)
        limits = np.where(
            tests.freedom > 0, quantile(poses, np.maximum(tests.freedom, 1.0)), np.inf
        )
        misfit = ~(tests.t <= limits)  # what is no number is one
        wrong = np.square(w) > quantile(readings, 1)
        remarkable: NDArray[np.bool_] = misfit | wrong.any(axis=0)
        return remarkable

    def _fit(self, problem: Problem, start: Array, loss: Loss | None) -> Solution:
        return self.result.fit.solver.safe.solve(replace(problem, start=start), loss=loss)

    def _robust(self, fit: Fitted) -> Fitted:
        """Huber's fit, its tuning constant in units of the scale that it finds itself."""
        everything = np.zeros(len(self.problem.poses), dtype=bool)
        for _ in range(3):
            solution = self._fit(self.problem, fit.parameters, _Scaled(Huber(), fit.factor))
            covariance = solution.spectrum.covariance()
            fit = replace(
                self._closed(fit, solution.parameters, solution.corrections),
                covariance=covariance,
            )
            fit = self._scaled(fit, everything)
        return fit

    def _fitted(self, fit: Fitted, gone: NDArray[np.bool_]) -> Fitted:
        """The fit of the poses that are not gone, loops closed in all."""
        keep = np.flatnonzero(~gone)
        solution = self._fit(taken(self.problem, keep), fit.parameters, None)
        corrections = fit.corrections.copy()
        corrections[:, keep] = solution.corrections
        fit = self._closed(fit, solution.parameters, corrections)
        fit = replace(fit, covariance=solution.spectrum.covariance())
        return self._scaled(fit, gone, cleaned=True)

    def _closed(self, fit: Fitted, parameters: Array, corrections: Array) -> Fitted:
        closed = settle(self.problem, parameters, corrections, exact=self.exact)
        return replace(fit, parameters=parameters, corrections=closed.corrections)

    def _scaled(self, fit: Fitted, gone: NDArray[np.bool_], *, cleaned: bool = False) -> Fitted:
        """The fit with the variance factor that the tests are to use.

        From the median of |E|^2 / r, so that outliers not yet gone do not count; once they are,
        no less than its mean, for scatter that differs from pose to pose has a low median.
        """
        if self.scale == "stated":
            return replace(fit, factor=1.0)
        factor = self._factor(fit, gone, cleaned)
        if self.scale == "auto" and factor < self._plausible(gone):
            factor = 1.0
        return replace(fit, factor=factor)

    def _factor(self, fit: Fitted, gone: NDArray[np.bool_], cleaned: bool) -> float:
        found = pose_equations(self.problem, fit.parameters, fit.corrections, exact=self.exact)
        ratios, total, equations = [], 0.0, 0
        for block in found:
            r = block.E.shape[1]
            if r:
                s = np.square(block.E).sum(axis=1)[~gone[block.poses]]
                ratios.append(s / quantile(0.5, r))
                total, equations = total + float(s.sum()), equations + r * len(s)
        middle = float(np.median(np.concatenate(ratios)))
        known = self.result.solution.equations
        spare = max(known - len(self.problem.free), 1) / known
        mean = total / equations if cleaned else 0.0
        return max(middle / spare, mean / spare, 1e-300)

    def _plausible(self, gone: NDArray[np.bool_]) -> float:
        """Up to here a median ratio is chance: its sd is about 1.5 / sqrt(poses)."""
        return 1.0 + 5.0 / float(np.sqrt(max(int((~gone).sum()), 1)))


@dataclass(frozen=True)
class _Scaled:
    """A loss whose unit is a multiple of the stated sds."""

    loss: Loss
    factor: float

    def rho(self, s: Array, r: int) -> Array:
        return self.factor * self.loss.rho(s / self.factor, r)

    def weight(self, s: Array, r: int) -> Array:
        return self.loss.weight(s / self.factor, r)

    def bend(self, s: Array, r: int) -> Array:
        return self.loss.bend(s / self.factor, r)
