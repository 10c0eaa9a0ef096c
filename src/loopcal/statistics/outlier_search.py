"""The search for the poses that do not fit: from a robust fit to a set that no longer changes.

One gross error bends a fit and hides itself and others. So the search starts from a robust fit,
leaves out what is remarkable there, fits the rest, and tests every pose against that fit, those
left out as well, until the same poses are left out twice (Rousseeuw and Leroy 1987). An image is a
pose, and is tested without those of its corners that do not fit the others (`wrong_corners`).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.faults.misfit import HALF, misfit
from loopcal.estimation.problem.pose_equations import rounding_left
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.loss import Huber, Loss
from loopcal.estimation.solve.solution import Solution
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.statistics.folds import blocks
from loopcal.statistics.pose_tests import (
    Fitted,
    PoseTests,
    independent,
    pose_tests,
    scatter_of_images,
    settle,
    tail,
)
from loopcal.statistics.wrong_corners import wrong_corners

# Concentration keeps the other seven tenths (docs/explanation/outliers.md).
MOST = 0.3
"""At most this share of the poses is taken for bad where the first search leaves doubts."""
ENOUGH = 1e-3
"""Where terms are learnt, whose sds nobody knows better, fits converge to so many sds."""
# A trimmed square must be a tenth smaller (record 0054).
_REGIONS, _MANY, _FINALISTS, _LESS = (4, 8), 6, 2, 0.9
# ln 2 = 0.69 for two degrees of freedom, 0.79 for three.
_MEDIAN = 0.75
"""Of chi-squared over its degrees of freedom, of two or three of them, at most 0.79."""
_MEDIAN_SD = 1.5
"""Relative sd of a median of |E|^2 / r, times the root of the number of poses."""
# Chosen, not derived: a cap; residuals of 10 sds, and a fit that brings outputs ten times as near,
# from which columns may be wrong. The last is the p-value of a single test (record 0054).
_ROUNDS, _HOPELESS, _BENT, _REJECTED = 10, 100.0, 10.0, 1e-3


class Search:
    """The search for the set of poses that do not fit."""

    def __init__(self, result: FitResult, level: float, scale: str) -> None:
        self.result, self.corners = result, wrong_corners(result, 0.5 * level)
        self.problem = self.corners.problem if self.corners.corners else result.problem
        self.exact = result.fit.solver.exact
        self.level = level
        learnt = scale == "auto" and result.estimate is not None
        self.scale = "residual" if self.exact or learnt else scale
        names = self.problem.mechanism.tape.quantities
        aside = set(self.problem.mechanism.disturbances)
        self.readings = np.array([name not in aside for name in names])
        read = [f.readings for f in self.problem.mechanism.families if f.form == PIXELS]
        self.pixels = np.array([any(name in some for some in read) for name in names])

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
        fit = Fitted(parameters, corrections, covariance, 1.0)
        fit = self._fitted(fit, none) if self.corners.corners else self._scaled(fit, none)
        tests = pose_tests(problem, fit, ~none)
        unremarkable = result.status.converged and not self._remarkable(tests).any()
        if unremarkable and fit.factor == 1.0:
            return fit, none, tests
        searched = self._searched(fit)
        # a scale from the residuals of a bent fit is too large to show what bent it; but without
        # their worst poses good data scatter less as well
        if unremarkable and searched[0].factor * self._plausible(none) > fit.factor:
            return fit, none, tests
        return searched

    def _searched(self, fit: Fitted) -> tuple[Fitted, NDArray[np.bool_], PoseTests]:
        """From a robust fit, and from a more robust one where that leaves doubts."""
        result, none = self.result, np.zeros(len(self.problem.poses), dtype=bool)
        fit = self._robust(fit)
        settled = self._settled(fit, none)
        if not self._doubtful(settled) or result.all_poses is not None:
            return settled
        centre = self._centre(fit, settled)
        if centre is None:
            return settled
        other = self._settled(*centre)
        return settled if self._doubtful(other) else other

    def _settled(
        self, fit: Fitted, gone: NDArray[np.bool_]
    ) -> tuple[Fitted, NDArray[np.bool_], PoseTests]:
        """From a fit without some poses to a set of them that no longer changes."""
        problem = self.problem
        gone = self._remarkable(pose_tests(problem, fit, ~gone))
        seen: list[NDArray[np.bool_]] = []
        for _ in range(_ROUNDS):
            gone = self._aside(gone)
            fit = self._fitted(fit, gone)
            tests = pose_tests(problem, fit, ~gone)
            now = self._remarkable(tests)
            if np.array_equal(now, gone):
                break
            # a set that comes again would come for ever: the larger one errs on the safe side
            now = now | gone if any(np.array_equal(now, old) for old in seen) else now
            seen.append(gone)
            gone = now
        return fit, self._remarkable(tests), tests

    def _doubtful(self, settled: tuple[Fitted, NDArray[np.bool_], PoseTests]) -> bool:
        """Whether the poses that are left do not look like good ones.

        They scatter more than the sds allow, or with a heavy tail where the scale is their own.
        """
        fit, gone, _ = settled
        ratios = self._ratios(fit)[~gone]
        ratios = ratios[np.isfinite(ratios)]
        if gone.mean() > MOST or not ratios.size:
            return True
        usual = float(np.median(ratios)) / _MEDIAN if self.scale == "residual" else self._spare(fit)
        return bool(ratios.mean() > usual * self._plausible(gone))

    def _centre(
        self, fit: Fitted, settled: tuple[Fitted, NDArray[np.bool_], PoseTests]
    ) -> tuple[Fitted, NDArray[np.bool_]] | None:
        """The fit with the least trimmed squares, and the poses (N,) that it leaves out; None where
        none is better than the one that was found.

        Concentration steps (Rousseeuw and Van Driessen 1999) from several starts: the poses nearest
        to the nominal machine, placed by the better half; all poses but those of one region of the
        joint space, where bad poses may support each other; and the poses of the fit at hand.
        """
        begun = self._concentrated(settled[0], self._aside(settled[1]), _MANY)
        tried = []
        for start in self._starts():
            with suppress(InputError, NoTrustworthyResult):
                tried.append(self._concentrated(fit, start, 1))
        for trial in sorted(tried, key=lambda one: one.square)[:_FINALISTS]:
            with suppress(InputError, NoTrustworthyResult):
                tried.append(self._concentrated(trial.fit, trial.gone, _MANY))
        best = min(tried, key=lambda one: one.square, default=begun)
        if not best.square < _LESS * begun.square:
            return None
        return self._scaled(best.fit, np.zeros_like(best.gone)), best.gone

    def _starts(self) -> list[NDArray[np.bool_]]:
        """Which poses (N,) the concentration begins without."""
        N = len(self.problem.poses)
        starts = []
        with suppress(InputError):
            away = misfit(self.problem, kept=HALF).away
            starts.append(self._farthest(np.where(np.isfinite(away), away, np.inf)))
        for number in _REGIONS:
            with suppress(InputError):
                data, mechanism = self.result.dataset, self.problem.mechanism
                for region in blocks(mechanism, data, np.arange(N), number):
                    if len(region) <= MOST * N:
                        starts.append(np.isin(np.arange(N), region))
        return starts

    def _concentrated(self, fit: Fitted, gone: NDArray[np.bool_], steps: int) -> _Centre:
        for _ in range(steps):
            fit = self._fitted(fit, gone)
            now = self._farthest(self._ratios(fit))
            if np.array_equal(now, gone):
                break
            gone = now
        ratios = self._ratios(fit)
        return _Centre(float(ratios[~self._farthest(ratios)].sum()), fit, gone)

    def _farthest(self, away: Array) -> NDArray[np.bool_]:
        """The `MOST` of the poses that are farthest off."""
        order = np.argsort(away, kind="stable")
        gone = np.zeros(len(away), dtype=bool)
        gone[order[math.ceil((1.0 - MOST) * len(away)) :]] = True
        return gone

    def _ratios(self, fit: Fitted) -> Array:
        """|E|^2 / r of every pose (N,), in units in which the median of a good one is that of a
        normal one; infinite where it is no number."""
        squares, equations = self._squares(fit)
        ratios = squares / np.maximum(equations, 1)
        return np.where(np.isfinite(ratios), ratios, np.inf)

    def _squares(self, fit: Fitted) -> tuple[Array, NDArray[np.intp]]:
        """|E|^2 of every pose (N,), and its number of equations (N,)."""
        squares = np.zeros(len(self.problem.poses))
        equations = np.zeros(len(squares), dtype=np.intp)
        for block in fit.equations(self.problem):
            squares[block.poses] = np.square(block.E).sum(axis=1)
            equations[block.poses] = block.count
        return squares, equations

    def tested(self, tests: PoseTests) -> int:
        """How many poses the tests speak of: of a stream all, for what fits badly is here."""
        return round(float((tests.freedom > 0).sum()) * self._share)

    @property
    def _share(self) -> float:
        every = self.result.all_poses
        return 1.0 if every is None else every.poses / self.problem.count

    def _aside(self, gone: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The poses to leave out of a fit: none where too few would be left."""
        return np.zeros_like(gone) if gone.mean() > 0.5 else gone

    def _remarkable(self, tests: PoseTests) -> NDArray[np.bool_]:
        # Half of the level for poses, half for readings, shared by all of each (Bonferroni). Of
        # images a half of the first is for where they stood.
        w = tests.w.copy()
        # a corner stands out from the others of its image
        rest = (tests.t - np.square(w[self.pixels])) / np.maximum(tests.freedom - 1, 1)
        w[self.pixels] /= np.sqrt(np.maximum(rest, 1.0))
        w = w[self.readings]
        poses = 0.5 * self.level / max(self.tested(tests), 1)
        readings = 0.5 * self.level / max(float(np.isfinite(w).sum()) * self._share, 1)
        images = tests.sharing.any()
        misfit = ~(tests.p_pose >= (0.5 * poses if images else poses))  # what is no number is one
        misfit |= ~(tests.p_shared >= 0.5 * poses) & (tests.sharing > 0)
        single = tail(np.square(np.nan_to_num(w)), np.ones(w.shape, np.intp), tests.denominator)
        return misfit | (single < readings).any(axis=0)

    def _fit(self, problem: Problem, start: Array, loss: Loss | None) -> Solution:
        solve = self.result.fit.solver.safe.solve
        tolerance = ENOUGH if self.result.learns_terms else None
        return solve(replace(problem, start=start), loss=loss, tolerance=tolerance)

    def _robust(self, fit: Fitted) -> Fitted:
        """Huber's fit, its tuning constant in units of the scale that it finds itself."""
        everything = np.zeros(len(self.problem.poses), dtype=bool)
        # Scale and fit depend on each other: each round takes the other as it stands.
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
        closed = settle(self.problem, parameters, corrections)
        return replace(fit, parameters=parameters, corrections=closed.corrections, blocks=())

    def _scaled(self, fit: Fitted, gone: NDArray[np.bool_], *, cleaned: bool = False) -> Fitted:
        """The fit with the variance factor that the tests are to use.

        From the median of |E|^2 / r, so that outliers not yet gone do not count; once they are,
        no less than its mean, for scatter that differs from pose to pose has a low median.
        """
        if self.scale == "stated":
            return replace(fit, factor=1.0, denominator=math.inf)
        fit = replace(fit, alike={}, blocks=())
        blocks = fit.equations(self.problem)
        if self.scale == "residual":
            fit = replace(fit, alike=independent(blocks, ~gone))
        fit = replace(fit, blocks=fit.turned(blocks))
        fit = replace(fit, images=self._images(fit))
        factor = self._factor(fit, gone, cleaned)
        if self.scale == "auto" and factor < self._plausible(gone):
            return replace(fit, factor=1.0, denominator=math.inf)
        # 2 / nu is the relative variance of the factor: of a mean, or of a median (`_plausible`).
        kept = float((~gone).sum())
        equations = self.result.solution.equations * self._spare(fit) * kept / len(gone)
        denominator = equations if cleaned else 2.0 * kept / _MEDIAN_SD**2
        return replace(fit, factor=factor, denominator=max(denominator, 1.0))

    def _images(self, fit: Fitted) -> float:
        """How alike images scatter, as `scatter_of_images` has it."""
        if not self.pixels.any():
            return math.inf
        return scatter_of_images(self._ratios(fit), self._squares(fit)[1])

    def _factor(self, fit: Fitted, gone: NDArray[np.bool_], cleaned: bool) -> float:
        pose_blocks = fit.equations(self.problem)
        squares, equations = (one[~gone] for one in self._squares(fit))
        squares, equations = squares[equations > 0], equations[equations > 0]
        middle = float(np.median(squares / quantile(0.5, equations.astype(float))))
        total = float(squares.sum() / equations.sum())
        spare, mean = self._spare(fit), total if cleaned else 0.0
        return max(middle / spare, mean / spare, rounding_left(self.problem, pose_blocks), 1e-300)

    def _spare(self, fit: Fitted) -> float:
        """The share of the equations that the parameters leave to the residuals.

        A parameter of prior sd s takes up 1 - C / s^2 of an equation, C its variance. The trace of
        the hat matrix is n - tr(C P^-1).
        """
        equations, taken = self.result.solution.equations, float(len(self.problem.free))
        if not self.exact:
            held = np.diag(fit.covariance) / np.square(self.problem.prior_sd)
            taken -= float(np.clip(held, 0.0, 1.0).sum())
        return max(equations - taken, 1.0) / equations

    def _plausible(self, gone: NDArray[np.bool_]) -> float:
        """Up to here a median ratio is chance: its sd is about `_MEDIAN_SD` / sqrt(poses)."""
        # 5 / 1.5 = 3.3 sds, which chance exceeds with a probability of 0.0004.
        return 1.0 + 5.0 / float(np.sqrt(max(int((~gone).sum()), 1)))


@dataclass(frozen=True)
class _Centre:
    """A fit of most poses, those left out (N,), and the trimmed sum of squares."""

    square: float
    fit: Fitted
    gone: NDArray[np.bool_]


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
