"""The globalised solver: damped Gauss-Newton steps on the profile of chi-squared.

It minimises a merit Phi(p) (`loopcal.estimation.solve.merit`), whose gradient is
-2 (sum D^T E - prior), exact where the loops are closed. A step is tried in full. It is damped
only if Phi does not fall as predicted, so that near the solution this is the iteration of the
thesis, (3.24) to (3.30). Where a step may raise Phi (`loopcal.estimation.solve.course`), the lowest
point is kept. The search returns to it if it finds no lower one in time, so Phi never ends higher
than it began.

Far from the solution, a trial is linearised where the readings stand, because closing the loops of
every trial would be wasted work. Its loops are closed only when that estimate rejects the step.
The end point always has closed loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.acceleration import accelerated
from loopcal.estimation.solve.checkpoint import Checkpoint, Point
from loopcal.estimation.solve.course import MOST_DAMPING, Course
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import (
    NONE_FAILED,
    Evaluation,
    Failed,
    Merit,
    State,
    without_state,
)
from loopcal.estimation.solve.reduction import hardly_determined, spectrum, vanished
from loopcal.estimation.solve.scratch import one_blas_thread, reuse_memory
from loopcal.estimation.solve.solution import End, Solution
from loopcal.estimation.solve.status import Status, weakness
from loopcal.estimation.solve.sweep import NEAR, Sweeper

Array = NDArray[np.float64]
Progress = Callable[[int, float, float], None]
"""Called with iteration, chi-squared and the predicted decrease."""

RELATIVE_STEP = 1e-11
"""Converged when what the next step leaves is this small beside the sds that the residuals
suggest: parameters then have ten digits. With large noise a step gains only two or three."""
_NEGLIGIBLE_STEP = 1e-6
"""The next step must be this small; if it no longer shrinks, only rounding is left."""
_NO_LONGER = 0.8
"""The decrement no longer shrinks when it keeps this share from one step to the next."""
_LAST_STEP = 0.1
"""Steps this small are taken with closed loops, so that the point they end at is final."""
_SLOW, _NEARBY = 0.1, 1.0
"""Steps are accelerated where the decrement keeps so much from one to the next, and the step is so
many sds."""
_AWAY = 30
"""After so many iterations above its lowest merit the search returns to that point."""
_FAR, _EXPLAINED = 100.0, 0.9
"""Where whitened residuals are this large (mean square) and parameters explain this share of
them, the loops need not be closed yet."""
_ONCE, _NEAR, _CLOSED = np.inf, NEAR, NEGLIGIBLE
"""Loops are closed until what is left to correct is at most so many sds: after a single correction
on the way, where that does not do, and at the end."""
_WIDE = 100
"""With so many parameters, loops closed to the end cost little beside the sums over all poses."""


def solve(
    problem: Problem,
    *,
    exact: bool = False,
    loss: Loss | None = None,
    max_iterations: int = 100,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The parameters of maximum likelihood, from the problem's start.

    exact: sensors are exact, minimise the loop values instead (the basic method; the prior
    takes no part). loss: None is the gaussian one. tolerance: converged when what the next step
    leaves is this small beside the sds that the residuals suggest, RELATIVE_STEP if None. Never
    returns a point with a larger merit than the start's.

    Raises InputError (DomainError) where the loops cannot be evaluated or closed at the start.
    """
    reuse_memory(8)
    with one_blas_thread():
        return solve_with(
            InMemory(Sweeper(problem, exact=exact, loss=loss)),
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )


def solve_with(
    merit: Merit[State],
    *,
    max_iterations: int = 100,
    tolerance: float | None = None,
    progress: Progress | None = None,
    reached: Callable[[Checkpoint[State]], None] | None = None,
    resume: Checkpoint[State] | None = None,
) -> End[State]:
    """The same for any merit function: the solver knows no more of a method.

    tolerance: as in `solve`; reached: called at the beginning of each iteration; resume: what it
    was called with in an interrupted run, from which this one goes on to the same end.
    """
    solver = _Solver(merit, tolerance, progress, reached)
    return solver.run(max_iterations, resume)


class _Solver(Generic[State]):
    def __init__(
        self,
        merit: Merit[State],
        tolerance: float | None,
        progress: Progress | None,
        reached: Callable[[Checkpoint[State]], None] | None,
    ) -> None:
        self.merit = merit
        self.tolerance = RELATIVE_STEP if tolerance is None else tolerance
        self.unknowns = merit.unknowns
        self.progress, self.reached = progress, reached
        self.triangular = False
        self.counted = 0  # evaluations of an interrupted run
        self.floor = 0.0
        self.iterations = 0
        self.before = np.inf
        self.course = Course()
        self.away = 0

    def run(self, max_iterations: int, resume: Checkpoint[State] | None) -> End[State]:
        current = self._resumed(resume) if resume else self._first()
        if resume:
            self.first, self.lowest, self.effects = resume.first, resume.lowest, resume.effects
        else:
            self.first = self.lowest = current.place
            self.effects = current.found.data.lengths
        while True:
            assert current.spectrum is not None
            if not (self.triangular or current.spectrum.well_conditioned):
                self.triangular = True
                current = self._evaluate(current.parameters, current.found.state)
                continue
            if current.merit < self.lowest.merit and current.closed is not None:
                self.lowest, self.away = current.place, 0
            elif self._higher(current) and (self.away > _AWAY or self._settled(current)):
                current = self._returned(current)
                continue
            if self._settled(current):
                if current.found.step <= NEGLIGIBLE or current.closed == _CLOSED:
                    return self._converged(current)
                current = self._evaluate(current.parameters, current.found.proposal, _CLOSED)
                if current.spectrum is None:
                    return self._give_up(current, "cannot_close")
                if self._settled(current):
                    continue
            assert current.spectrum is not None
            if self.iterations >= max_iterations:
                return self._give_up(current, "max_iterations")
            if self.reached:
                self.reached(self._checkpoint(current))
            self.iterations += 1
            if self.progress:
                self.progress(self.iterations, current.merit, current.spectrum.decrement)
            self.away += 1
            trial = self._advance(current)
            if trial is None and self._higher(current):
                trial = self._returned(current)
            if trial is None:
                return self._stalled(current)
            self.before = current.spectrum.decrement
            current = trial

    def _higher(self, point: Point[State]) -> bool:
        """Whether the search has left its lowest point for one that is higher by more than what
        loops that are not quite closed make uncertain."""
        return point.merit > self.lowest.merit + self._limit(point, _LAST_STEP)

    def _returned(self, current: Point[State]) -> Point[State]:
        """The lowest point, or the current one if that is lower once both have closed loops.

        From there every step must descend.
        """
        self.course, self.away, self.before = self.course.returned(), 0, np.inf
        lowest = self._evaluate(self.lowest.parameters, self.lowest.state, _NEAR)
        point = lowest if lowest.merit < current.merit else current
        self.lowest = point.place
        return point

    def _first(self) -> Point[State]:
        start = self.unknowns.start
        found = self.merit.first(start)
        # n directions, each with the square of what rounding does to whitened residuals
        self.floor = len(self.unknowns.free) * found.rounding**2
        point = self._point(start, found)
        assert point.spectrum is not None
        if point.closed is None and not self._far(point, point.spectrum.decrement):
            point = self._evaluate(start, found.state, _NEAR)
        return self._nearer(point) or point

    def _nearer(self, point: Point[State]) -> Point[State] | None:
        """The same parameters with loops closed nearer to the readings; None where they are not.

        It is tried where the steps that closed the loops did not shrink.
        """
        if point.closed is None or point.found.contraction < 1.0:
            return None
        state = self.merit.nearer(point.parameters, point.found.state)
        if state is None:
            return None
        other = self._evaluate(point.parameters, state, _CLOSED)
        return other if other.spectrum is not None and other.merit < point.merit else None

    def _checkpoint(self, current: Point[State]) -> Checkpoint[State]:
        return Checkpoint(
            self.first,
            current.place,
            self.lowest,
            self.effects,
            self.course.last_step,
            self.course.recent,
            self.course.damping,
            self.before,
            self.floor,
            self.away,
            self.course.descend,
            self.triangular,
            self.iterations,
            self.counted + self.merit.evaluations,
        )

    def _resumed(self, kept: Checkpoint[State]) -> Point[State]:
        self.before, self.floor, self.away = kept.before, kept.floor, kept.away
        self.course = Course(kept.damping, kept.last_step, kept.descend, recent=kept.recent)
        self.triangular, self.iterations = kept.triangular, kept.iterations
        place = kept.current
        point = self._evaluate(place.parameters, place.state, place.closing)
        self.counted = kept.evaluations - self.merit.evaluations
        return point

    def _evaluate(
        self,
        parameters: Array,
        state: State,
        closing: float | None = None,
        contraction: float = 1.0,
    ) -> Point[State]:
        with np.errstate(over="ignore", invalid="ignore"):  # a trial far off may overflow
            found = self.merit.evaluate(
                parameters,
                state,
                triangular=self.triangular,
                closing=closing,
                contraction=contraction,
            )
            return self._point(parameters, found)

    def _point(self, parameters: Array, found: Evaluation[State]) -> Point[State]:
        merit = found.cost + self.unknowns.prior_square(parameters)
        bad = not math.isfinite(merit) or bool(found.late) or bool(found.singular)
        system = None
        if found.finite:
            offset = self.unknowns.offset(parameters)
            system = spectrum(found.data, offset, self.unknowns.prior_sd)
        return Point(parameters, found, np.inf if bad else merit, system, found.closing)

    def _advance(self, current: Point[State]) -> Point[State] | None:
        """The next accepted point; None where no step is accepted."""
        if (fast := self._fast(current)) is not None:
            return fast
        while self.course.damping < MOST_DAMPING:
            system = current.spectrum
            assert system is not None
            predicted = system.predicted(self.course.damping)
            step = system.step(self.course.damping)
            trial = self._try(current, step, predicted)
            if trial is not None:
                gain = (current.merit - trial.merit) / predicted if predicted > 0 else 1.0
                self.course = self.course.accepted(system, step, gain)
                return trial
            # The merit of open loops is an estimate: close them as well as the trial's.
            closing = _CLOSED if self._last(current, predicted) else _NEAR
            if current.closed is None or current.closed > closing:
                closed = self._evaluate(current.parameters, current.found.proposal, closing)
                if math.isfinite(closed.merit) and closed.spectrum is not None:
                    current = closed
                    continue
                current = replace(current, closed=closing)
            self.course = self.course.rejected(system)
        return None

    def _fast(self, current: Point[State]) -> Point[State] | None:
        """The point after an accelerated step; None where there is none that descends.

        Steps are accelerated near the end, where they no longer shrink by much.
        """
        system, recent, slow = current.spectrum, self.course.recent, _SLOW * self.before
        assert system is not None
        if recent is None or current.closed is None or not slow < system.decrement < math.inf:
            return None
        if system.decrement > self._limit(current, _NEARBY):
            return None
        step = accelerated(recent, system)
        if step is not None:
            parameters = self.unknowns.moved(current.parameters, step)
            last = self._last(current, system.decrement)
            closing = _CLOSED if last or self._wide else _ONCE
            start, contraction = current.found.proposal, current.found.contraction
            trial = self._evaluate(parameters, start, closing, contraction)
            if self._worth(current, trial, system.decrement):
                gain = (current.merit - trial.merit) / system.decrement
                self.course = self.course.accepted(system, step, max(gain, 0.0))
                return trial
        self.course = self.course.unaccelerated()
        return None

    def _try(self, current: Point[State], step: Array, predicted: float) -> Point[State] | None:
        """The point after a step if its merit falls as it should, or may rise; else None."""
        assert current.spectrum is not None
        parameters = self.unknowns.moved(current.parameters, step)
        far = self._far(current, predicted)
        last = self._last(current, predicted)
        start = current.found.state if far else current.found.proposal
        closings = [None, _NEAR] if far else [_CLOSED] if last or self._wide else [_ONCE, _NEAR]
        for closing in closings:
            trial = self._evaluate(parameters, start, closing, current.found.contraction)
            if self._worth(current, trial, predicted):
                return trial
        share = self.course.may_rise(current.spectrum.scale, step)
        rises = not far and trial.spectrum is not None and share < 1.0
        return trial if rises and share * trial.merit <= current.merit else None

    def _far(self, point: Point[State], predicted: float) -> bool:
        """Whether parameters explain nearly all of a large misclosure: then readings can wait."""
        return predicted > max(_EXPLAINED * point.merit, _FAR * point.found.equations)

    @property
    def _wide(self) -> bool:
        """Whether a sweep costs so much that none should be made only to close the loops."""
        return len(self.unknowns.free) >= _WIDE

    def _last(self, point: Point[State], predicted: float) -> bool:
        """Whether the step from a point is so small that the next point should be final."""
        return predicted <= self._limit(point, _LAST_STEP)

    def _worth(self, current: Point[State], trial: Point[State], predicted: float) -> bool:
        if not math.isfinite(trial.merit) or trial.spectrum is None:
            return False
        # Each of many residuals E carries a rounding d, so the merit wavers by about 2 |E| |d|.
        wavering = 4 * math.sqrt(current.merit * self.floor) + 1e-13 * current.merit
        if predicted <= wavering:
            return trial.spectrum.decrement <= 2 * predicted
        return bool(current.merit - trial.merit >= 1e-3 * predicted - wavering)

    def _settled(self, point: Point[State]) -> bool:
        """Whether the next step leaves nothing beside the sds that the residuals suggest."""
        assert point.spectrum is not None
        decrement = point.spectrum.decrement
        if not self._negligible(point):
            return False
        rate = min(decrement / self.before, 1.0) if math.isfinite(self.before) else 1.0
        stuck = math.isfinite(self.before) and rate > _NO_LONGER
        return stuck or rate * decrement <= self._limit(point, self.tolerance)

    def _negligible(self, point: Point[State]) -> bool:
        """Whether the loops close and the next step is too small to matter."""
        if point.spectrum is None or not math.isfinite(point.merit):
            return False
        negligible = max(_NEGLIGIBLE_STEP, self.tolerance)
        return point.spectrum.decrement <= self._limit(point, negligible)

    def _limit(self, point: Point[State], step: float) -> float:
        """The decrement of a step of so many sds in each of the n directions."""
        n = len(self.unknowns.free)
        variance = point.merit / max(point.found.equations - n, 1)
        return max(step**2 * n * variance, self.floor)

    def _converged(self, point: Point[State]) -> End[State]:
        """The end: the last step is taken, and the loops are closed there, without a new sweep.

        The step is too small to change merit or spectrum by more than rounding.
        """
        assert point.spectrum is not None
        parameters = self.unknowns.moved(point.parameters, point.spectrum.step())
        start, contraction = point.found.proposal, point.found.contraction
        closed = self.merit.close(parameters, start, RELATIVE_STEP, contraction)
        gone = vanished(point.spectrum, point.found.data.lengths, self.effects)
        reason = "runaway" if gone.any() else "converged"
        if closed is None:
            return self._solution(point, reason)
        return self._solution(replace(point, parameters=parameters), reason, closed)

    def _stalled(self, current: Point[State]) -> End[State]:
        """The end where no step lowers the merit: given up, unless only rounding is in the way."""
        end = self._evaluate(current.parameters, current.found.proposal, _CLOSED)
        return self._converged(end) if self._negligible(end) else self._give_up(current, "stalled")

    def _give_up(self, current: Point[State], reason: str) -> End[State]:
        end = self._evaluate(current.parameters, current.found.proposal, _CLOSED)
        late = end.found.late
        if late or end.spectrum is None:
            # the merit of open loops is no merit: any point with closed loops is a better end
            end, reason = replace(current, merit=np.inf, closed=None), "cannot_close"
        for place in (self.lowest, self.first):
            if not end.merit <= place.merit:
                for closing in (_CLOSED, _NEAR):
                    other = self._evaluate(place.parameters, place.state, closing)
                    if math.isfinite(other.merit) and other.spectrum is not None:
                        end = other if other.merit <= end.merit else end
                        break
        return self._solution(end, reason, late=late)

    def _solution(
        self,
        end: Point[State],
        reason: str,
        closed: State | None = None,
        late: Failed = NONE_FAILED,
    ) -> End[State]:
        detail = ""
        if reason == "cannot_close" and late:
            detail = f"Poses: {', '.join(late.poses)}."
        assert end.spectrum is not None
        if reason == "runaway":
            gone = np.flatnonzero(vanished(end.spectrum, end.found.data.lengths, self.effects))
            detail = f"Parameters: {', '.join(self.unknowns.names[i] for i in gone)}."
        if reason in ("max_iterations", "stalled"):
            detail = weakness(hardly_determined(end.spectrum, self.unknowns.names))
        evaluations = (self.counted + self.merit.evaluations) / end.found.poses
        if closed is None:
            near = end.found.step <= 1.0  # a longer step may lead anywhere
            closed = end.found.proposal if near else end.found.state
        return End(
            end.parameters,
            closed,
            without_state(end.found),
            end.spectrum,
            self.unknowns.prior_square(end.parameters),
            Status.of(reason, self.iterations, evaluations, detail),
        )
