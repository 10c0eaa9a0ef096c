"""The globalised solver: damped Gauss-Newton steps on the profile of chi-squared.

The merit function is Phi(p), the least weighted square of the corrections that close all loops at
p, plus the prior's (`loopcal.estimation.solve.sweep`); its gradient is -2 (sum D^T E - prior),
exact where the corrections are. A step is tried in full and damped (Levenberg 1944, Marquardt 1963)
only if Phi does not fall as predicted, so that near the solution this is the seed's iteration
(3.24) to (3.30). Far from the solution, closing the loops of every trial would be work for nothing:
there a trial is linearised where the readings stand, and its loops are closed only when that
estimate speaks against the step. The end point is always evaluated with closed loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.reduction import (
    WELL_CONDITIONED,
    Spectrum,
    hardly_determined,
    spectrum,
)
from loopcal.estimation.solve.scratch import one_blas_thread, reuse_memory
from loopcal.estimation.solve.status import Status
from loopcal.estimation.solve.sweep import NEAR, NEGLIGIBLE, Sweep, Sweeper
from loopcal.expressions.domain import explain_domain

Array = NDArray[np.float64]
Progress = Callable[[int, float, float], None]
"""Called with iteration, chi-squared and the predicted decrease."""

RELATIVE_STEP = 1e-11
"""Converged when what the next step leaves is this small beside the sds that the residuals
suggest: parameters then have ten digits. With large noise a step gains only two or three."""
_NEGLIGIBLE_STEP = 1e-6
"""The next step must be this small; if it no longer shrinks, only rounding is left."""
_LAST_STEP = 0.1
"""Steps this small are taken with closed loops, so that the point they end at is final."""
_MOST_DAMPING = 1e6
_FAR, _EXPLAINED = 100.0, 0.9
"""Where whitened residuals are this large (mean square) and parameters explain this share of
them, the loops need not be closed yet."""
_ONCE, _NEAR, _CLOSED = np.inf, NEAR, NEGLIGIBLE
"""Loops are closed until what is left to correct is at most so many sds: after a single correction
on the way, where that does not do, and at the end."""


@dataclass(frozen=True)
class Solution:
    """Where a fit ended.

    parameters: (n_all,) [SI]; corrections: (k, N) [SI] that close the loops there; sweep: the
    last one; spectrum: of data and prior; prior_square: (p - nominal)^2 over prior variance,
    summed; status.
    """

    parameters: Array
    corrections: Array
    sweep: Sweep
    spectrum: Spectrum
    prior_square: float
    status: Status

    @property
    def chi_squared(self) -> float:
        """The merit: corrections, or what the loss makes of them, and prior together."""
        return self.sweep.cost + self.prior_square


@dataclass(frozen=True)
class _Point:
    """A trial: parameters, sweep, merit and parameter system; closed: how well its loops are."""

    parameters: Array
    sweep: Sweep
    merit: float
    spectrum: Spectrum | None
    closed: float | None


@dataclass(frozen=True)
class _Start:
    """Where the search began."""

    parameters: Array
    corrections: Array
    merit: float


def solve(
    problem: Problem,
    *,
    exact: bool = False,
    max_iterations: int = 100,
    progress: Progress | None = None,
) -> Solution:
    """The parameters of maximum likelihood, from the problem's start.

    exact: sensors are exact, minimise the loop values instead (the basic method; the prior
    takes no part). Never returns a point with a larger merit than the start's.

    Raises InputError (DomainError) where the loops cannot be evaluated or closed at the start.
    """
    reuse_memory(8)
    with one_blas_thread():
        return solve_with(
            Sweeper(problem, exact=exact), max_iterations=max_iterations, progress=progress
        )


def solve_with(
    sweeper: Sweeper, *, max_iterations: int = 100, progress: Progress | None = None
) -> Solution:
    """The same for any sweeper: the solver knows no more of a method than its sweeps."""
    return _Solver(sweeper, progress).run(max_iterations)


class _Solver:
    def __init__(self, sweeper: Sweeper, progress: Progress | None) -> None:
        self.sweeper = sweeper
        self.prior_sd = sweeper.prior_sd
        self.progress = progress
        self.triangular = False
        self.floor = 0.0
        self.iterations = 0
        self.before = np.inf

    @property
    def problem(self) -> Problem:
        """The sweeper's, which may count its equations in the first sweep."""
        return self.sweeper.problem

    def run(self, max_iterations: int) -> Solution:
        current = self._first()
        # of the first point only what it takes to return to it: arrays by pose are large
        first = _Start(current.parameters, current.sweep.corrections, current.merit)
        damping = 0.0
        while True:
            assert current.spectrum is not None
            if not self.triangular and current.spectrum.condition > WELL_CONDITIONED:
                self.triangular = True
                current = self._evaluate(current.parameters, current.sweep.corrections)
                continue
            if self._settled(current):
                if current.sweep.step <= NEGLIGIBLE or current.closed == _CLOSED:
                    return self._converged(current)
                current = self._evaluate(current.parameters, current.sweep.proposal, _CLOSED)
                if current.spectrum is None:
                    return self._give_up(first, current, "cannot_close")
                if self._settled(current):
                    continue
            assert current.spectrum is not None
            if self.iterations >= max_iterations:
                return self._give_up(first, current, "max_iterations")
            self.iterations += 1
            if self.progress:
                self.progress(self.iterations, current.merit, current.spectrum.decrement)
            trial, damping = self._advance(current, damping)
            if trial is None:
                return self._stalled(first, current)
            self.before = current.spectrum.decrement
            current = trial

    def _first(self) -> _Point:
        corrections = start_corrections(self.sweeper, self.problem.start)
        closing = _NEAR if any(p.unmeasured for p in self.problem.patterns) else None
        point = self._evaluate(self.problem.start, corrections, closing)
        if not point.sweep.finite:
            raise explain_domain(
                self.problem.mechanism.tape,
                self.problem.readings,
                self.problem.known,
                point.parameters,
                self.problem.poses,
                self.problem.mechanism.remedies,
            )
        if point.sweep.singular.size:
            raise self._cannot_close(point.sweep)
        assert self.sweeper.rounding is not None
        # n directions, each with the square of what rounding does to whitened residuals
        self.floor = len(self.problem.free) * self.sweeper.rounding**2
        assert point.spectrum is not None
        if closing is None and not self._far(point, point.spectrum.decrement):
            return self._evaluate(point.parameters, corrections, _NEAR)
        return point

    def _cannot_close(self, sweep: Sweep) -> InputError:
        pose = self.problem.pose(int(sweep.singular[0]))
        return InputError(
            f"the loops of {sweep.singular.size} poses cannot close, the first is pose {pose!r}: "
            "some equation there contains no uncertain quantity that could be corrected",
            remedy="give at least one quantity of every loop equation an sd above zero",
        )

    def _evaluate(
        self,
        parameters: Array,
        corrections: Array,
        closing: float | None = None,
        contraction: float = 1.0,
    ) -> _Point:
        sweep = self.sweeper.sweep(
            parameters,
            corrections,
            triangular=self.triangular,
            closing=closing,
            contraction=contraction,
        )
        offset = self.problem.nominal - parameters[self.problem.free]
        off = offset / self.prior_sd
        prior = float(off @ off)
        merit = sweep.cost + prior
        bad = not math.isfinite(merit) or bool(sweep.open_poses.size) or bool(sweep.singular.size)
        system = spectrum(sweep.data, offset, self.prior_sd) if sweep.finite else None
        return _Point(parameters, sweep, np.inf if bad else merit, system, closing)

    def _advance(self, current: _Point, damping: float) -> tuple[_Point | None, float]:
        """The next accepted point, None where no step lowers the merit; and the damping then."""
        while damping < _MOST_DAMPING:
            system = current.spectrum
            assert system is not None
            predicted = system.predicted(damping)
            parameters = current.parameters.copy()
            parameters[self.problem.free] += system.step(damping)
            trial = self._try(current, parameters, predicted)
            weakest = float(np.square(system.singular_values[system.kept].min(initial=1.0)))
            if trial is not None:
                gain = (current.merit - trial.merit) / predicted if predicted > 0 else 1.0
                if gain < 0.25:
                    return trial, max(4 * damping, 0.1 * weakest)
                damping = damping / 10 if gain > 0.75 else damping
                return trial, damping if damping > 1e-3 * weakest else 0.0
            if current.closed in (None, _ONCE):
                closed = self._evaluate(current.parameters, current.sweep.proposal, _NEAR)
                if math.isfinite(closed.merit) and closed.spectrum is not None:
                    current = closed
                    continue
                current = replace(current, closed=_NEAR)
            damping = max(10 * damping, 0.1 * weakest)
        return None, damping

    def _try(self, current: _Point, parameters: Array, predicted: float) -> _Point | None:
        """The point at these parameters if its merit falls as it should, else None."""
        far = self._far(current, predicted)
        last = predicted <= self._limit(current.merit, _LAST_STEP)
        start = current.sweep.corrections if far else current.sweep.proposal
        closings = [None, _NEAR] if far else [_CLOSED] if last else [_ONCE, _NEAR]
        for closing in closings:
            trial = self._evaluate(parameters, start, closing, current.sweep.contraction)
            if self._worth(current, trial, predicted):
                return trial
        return None

    def _far(self, point: _Point, predicted: float) -> bool:
        """Whether parameters explain nearly all of a large misclosure: then readings can wait."""
        return predicted > max(_EXPLAINED * point.merit, _FAR * self.problem.equations)

    def _worth(self, current: _Point, trial: _Point, predicted: float) -> bool:
        if not math.isfinite(trial.merit) or trial.spectrum is None:
            return False
        # Each of many residuals E carries a rounding d, so the merit wavers by about 2 |E| |d|.
        wavering = 4 * np.sqrt(current.merit * self.floor) + 1e-13 * current.merit
        if predicted <= wavering:
            return trial.spectrum.decrement <= 2 * predicted
        return bool(current.merit - trial.merit >= 1e-3 * predicted - wavering)

    def _settled(self, point: _Point) -> bool:
        """Whether the next step leaves nothing beside the sds that the residuals suggest."""
        assert point.spectrum is not None
        decrement = point.spectrum.decrement
        if not self._negligible(point):
            return False
        rate = min(decrement / self.before, 1.0) if math.isfinite(self.before) else 1.0
        stuck = math.isfinite(self.before) and rate > 0.25
        return stuck or rate * decrement <= self._limit(point.merit, RELATIVE_STEP)

    def _negligible(self, point: _Point) -> bool:
        """Whether the loops close and the next step is too small to matter."""
        if point.spectrum is None or not math.isfinite(point.merit):
            return False
        return point.spectrum.decrement <= self._limit(point.merit, _NEGLIGIBLE_STEP)

    def _limit(self, merit: float, step: float) -> float:
        """The decrement of a step of so many sds in each of the n directions."""
        n = len(self.problem.free)
        variance = merit / max(self.problem.equations - n, 1)
        return max(step**2 * n * variance, self.floor)

    def _converged(self, point: _Point) -> Solution:
        """The end: the last step is taken, and the loops are closed there, without a new sweep.

        The step is too small to change merit or spectrum by more than rounding.
        """
        assert point.spectrum is not None
        parameters = point.parameters.copy()
        parameters[self.problem.free] += point.spectrum.step()
        start, contraction = point.sweep.proposal, point.sweep.contraction
        closed = self.sweeper.close(parameters, start, RELATIVE_STEP, contraction)
        if closed.open.any():
            return self._solution(point, "converged")
        end = replace(point, parameters=parameters)
        return self._solution(end, "converged", closed.corrections)

    def _stalled(self, first: _Start, current: _Point) -> Solution:
        """The end where no step lowers the merit: given up, unless only rounding is in the way."""
        end = self._evaluate(current.parameters, current.sweep.proposal, _CLOSED)
        if self._negligible(end):
            return self._converged(end)
        return self._give_up(first, current, "stalled")

    def _give_up(self, first: _Start, current: _Point, reason: str) -> Solution:
        end = self._evaluate(current.parameters, current.sweep.proposal, _CLOSED)
        open_poses = end.sweep.open_poses
        if open_poses.size or end.spectrum is None:
            end = replace(current, closed=None)
            reason = "cannot_close"
        if not end.merit <= first.merit:
            start = self._evaluate(first.parameters, first.corrections, _CLOSED)
            end = start if start.merit <= end.merit else end
        return self._solution(end, reason, open_poses=open_poses)

    def _solution(
        self,
        end: _Point,
        reason: str,
        corrections: Array | None = None,
        open_poses: Sequence[int] | NDArray[np.intp] = (),
    ) -> Solution:
        detail = ""
        if reason == "cannot_close" and len(open_poses):
            some = [self.problem.pose(int(i)) for i in open_poses[:5]]
            detail = f"Poses: {', '.join(some)}."
        assert end.spectrum is not None
        if reason in ("max_iterations", "stalled"):
            detail = _weakness(hardly_determined(end.spectrum, self.problem.names))
        off = (self.problem.nominal - end.parameters[self.problem.free]) / self.prior_sd
        status = Status.of(
            reason, self.iterations, self.sweeper.evaluations / self.problem.count, detail
        )
        if corrections is None:
            near = end.sweep.step <= 1.0  # a longer step may lead anywhere
            corrections = end.sweep.proposal if near else end.sweep.corrections
        # arrays by pose are large: of those on the way nothing is kept
        sweep = replace(end.sweep, corrections=corrections, proposal=corrections)
        return Solution(end.parameters, corrections, sweep, end.spectrum, float(off @ off), status)


def _weakness(names: tuple[str, ...]) -> str:
    """What to do about a direction that the poses hardly determine; nothing if there is none."""
    if not names:
        return ""
    return (
        f"These poses hardly tell apart {', '.join(names)}: fix one of them or give it a prior sd, "
        'and describe axes that are nearly parallel by the form "hayati" or by transitions.'
    )
