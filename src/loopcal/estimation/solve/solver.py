"""The globalised solver: damped Gauss-Newton steps on the profile of chi-squared.

It minimises a merit Phi(p) (`loopcal.estimation.solve.merit`), whose gradient is
-2 (sum D^T E - prior), exact where the loops are closed. A step is tried in full. It is damped
only if Phi does not fall as predicted, so that near the solution this is the iteration of the
thesis, (3.24) to (3.30). The lowest point is kept, so Phi never ends higher than it began.

Where poses are alike, Phi has long, narrow, curved valleys. A damped step s along one leaves its
floor, and Phi rises although the floor falls. Such a step is corrected before it is rejected: what
it should have been minimises Phi(p + s) + damping |s|^2, whose floor does not leave the valley
(the proximal point of Martinet 1970), and each correction is one step of Gauss and Newton towards
it, made where the last one ended. The first is the geodesic acceleration of Transtrum and Sethna
(2012), without their derivatives.

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

from loopcal.arrays import Array
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.checkpoint import Checkpoint, Point
from loopcal.estimation.solve.course import MOST_DAMPING, accelerated
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
from loopcal.estimation.solve.reduction import hardly_determined, overflowing, spectrum, vanished
from loopcal.estimation.solve.scratch import one_blas_thread, reuse_memory
from loopcal.estimation.solve.solution import MOST_ITERATIONS, End, Solution, Status, weakness
from loopcal.estimation.solve.sweep import NEAR, Sweeper

Progress = Callable[[int, float, float], None]
"""Called with iteration, chi-squared and the predicted decrease."""

# This and _NEGLIGIBLE_STEP: docs/decisions/0002.
RELATIVE_STEP = 1e-11
"""Converged when what the next step leaves is this small beside the sds that the residuals
suggest: parameters then have ten digits. With large noise a step gains only two or three."""
_NEGLIGIBLE_STEP = 1e-6
"""The next step must be this small; if it no longer shrinks, only rounding is left."""
# Chosen, not derived: steps of a fit that still converges shrink faster.
_NO_LONGER = 0.8
"""The decrement no longer shrinks when it keeps this share from one step to the next."""
# Chosen, not derived: earlier steps need no closed loops, later ones decide the end.
_LAST_STEP = 0.1
"""Steps this small are taken with closed loops, so that the point they end at is final."""
# Chosen, not derived: faster fits need no acceleration, and far from the end it misleads.
_SLOW, _NEARBY = 0.1, 1.0
"""Steps are accelerated where the decrement keeps so much from one to the next, and the step is so
many sds."""
# docs/decisions/0002: corrections of any length are faster on the left arm's grid, but two of
# NIST's problems then end elsewhere.
_CORRECTIONS, _SHRINK = 5, 0.75
"""A step is corrected so often at most, as long as each correction has this share of the last."""
_GAIN, _GAIN_CORRECTED = 1e-3, 0.5
"""The merit must fall by this share of what is predicted; after a correction, which leads farther
than the linearised loops are known to hold, by more."""
# docs/decisions/0002: limits are by progress, MOST_ITERATIONS is only the cap.
_PATIENCE, _PROGRESS = 100, 1e-9
"""The search ends where so many iterations lower the merit by no more than this share of it."""
# Chosen, not derived: at this pace a thousand steps leave a third of a misfit, which stays gross.
_GROSS = 0.1
"""The same share where whitened residuals are as large as `_FAR`: readings do not belong to
this machine, or the start is wrong."""
# docs/decisions/0140: a third of an sd, along a valley in which 1,000 steps would not gain it.
_CREEPING, _LEFT = 1e-3, 0.1
"""It ends as well where they lower it by no more than this share of the variance of a residual, and
the next step would gain no more than that share of it."""
# Chosen, not derived: residuals of 10 sds, of which the next step takes two thirds.
_FAR, _EXPLAINED = 100.0, 0.9
"""Where whitened residuals are this large (mean square) and parameters explain this share of
them, the loops need not be closed yet."""
_ONCE, _NEAR, _CLOSED = np.inf, NEAR, NEGLIGIBLE
"""Loops are closed until what is left to correct is at most so many sds: after a single correction
on the way, where that does not do, and at the end."""
# Chosen, not derived: sums grow with the square of the parameters, closing loops does not.
_WIDE = 100
"""With so many parameters, loops closed to the end cost little beside the sums over all poses."""


def solve(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The parameters of maximum likelihood, from the problem's start.

    Where the loops of the problem count alike, of the least squares of their values, and the prior
    takes no part. loss: None is the gaussian one. tolerance: converged when what the next step
    leaves is this small beside the sds that the residuals suggest, RELATIVE_STEP if None. Never
    returns a point with a larger merit than the start's.

    Raises InputError (DomainError) where the loops cannot be evaluated or closed at the start.
    """
    reuse_memory(8)
    with one_blas_thread():
        return solve_with(
            InMemory(Sweeper(problem, loss=loss)),
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )


def solve_with(
    merit: Merit[State],
    *,
    max_iterations: int = MOST_ITERATIONS,
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
        self.search: Checkpoint[State]

    def run(self, max_iterations: int, resume: Checkpoint[State] | None) -> End[State]:
        current = self._resumed(resume) if resume else self._first()
        while True:
            assert current.spectrum is not None
            # First, because all below judges the decrement, of which normal equations may lack
            # digits.
            if not (self.search.triangular or current.spectrum.well_conditioned):
                self.search.triangular = True
                current = self._evaluate(current.parameters, current.evaluation.state)
                continue
            # Open loops may have a merit below that of any closed ones (docs/decisions/0002).
            if current.merit < self.search.lowest.merit and current.closed is not None:
                self.search.lowest = current.place
            elif self._higher(current) and self._settled(current):
                current = self._returned(current)
                continue
            if self._settled(current):
                if current.evaluation.step <= NEGLIGIBLE or current.closed == _CLOSED:
                    return self._converged(current)
                current = self._evaluate(current.parameters, current.evaluation.proposal, _CLOSED)
                if current.spectrum is None:
                    return self._give_up(current, "cannot_close")
                if self._settled(current):
                    continue
            assert current.spectrum is not None
            if self.search.iterations >= max_iterations:
                return self._give_up(current, "max_iterations")
            self.search.current = current.place
            if self.reached:
                self.reached(replace(self.search, evaluations=self.evaluations))
            iterations = self.search.iterations + 1
            self.search.iterations = iterations
            if self.progress:
                self.progress(iterations, current.merit, current.spectrum.decrement)
            trial = self._advance(current)
            if trial is None and self._higher(current):
                trial = self._returned(current)
            if trial is None:
                return self._stalled(current)
            self.search.before = current.spectrum.decrement
            current = trial
            if iterations % _PATIENCE == 0:
                noted, merit = self.search.noted, self.search.lowest.merit
                self.search.noted = merit
                variance = self._limit(current, 1.0) / len(self.unknowns.free)
                left = current.spectrum.decrement if current.spectrum is not None else np.inf
                if noted - merit <= _CREEPING * variance and left <= _LEFT * variance:
                    return self._give_up(current, "crept")
                if not merit < (1 - (_GROSS if variance > _FAR else _PROGRESS)) * noted:
                    return self._give_up(current, "stalled")

    @property
    def evaluations(self) -> int:
        """Loop evaluations so far, those of an interrupted run included."""
        return self.search.evaluations + self.merit.evaluations

    def _higher(self, point: Point[State]) -> bool:
        """Whether the search has left its lowest point for one that is higher by more than what
        loops that are not quite closed make uncertain."""
        return point.merit > self.search.lowest.merit + self._limit(point, _LAST_STEP)

    def _returned(self, current: Point[State]) -> Point[State]:
        """The lowest point, or the current one if that is lower once both have closed loops."""
        place = self.search.lowest
        lowest = self._evaluate(place.parameters, place.state, _NEAR)
        point = lowest if lowest.merit < current.merit else current
        self.search.course, self.search.before = self.search.course.returned(), np.inf
        self.search.lowest = point.place
        return point

    @overflowing
    def _first(self) -> Point[State]:
        start = self.unknowns.start
        evaluation = self.merit.first(start)
        # n directions, each with the square of what rounding does to whitened residuals
        floor = len(self.unknowns.free) * evaluation.rounding**2
        point = self._point(start, evaluation)
        self.search = Checkpoint.at(point, floor)
        assert point.spectrum is not None
        if point.closed is None and not self._far(point, point.spectrum.decrement):
            point = self._evaluate(start, evaluation.state, _NEAR)
        point = self._nearer(point) or point
        self.search = Checkpoint.at(point, floor)
        return point

    def _nearer(self, point: Point[State]) -> Point[State] | None:
        """The same parameters with loops closed nearer to the readings; None where they are not.

        It is tried where the steps that closed the loops did not shrink.
        """
        if point.closed is None or not point.evaluation.swelling:
            return None
        state = self.merit.nearer(point.parameters, point.evaluation.state)
        if state is None:
            return None
        other = self._evaluate(point.parameters, state, _CLOSED)
        return other if other.spectrum is not None and other.merit < point.merit else None

    def _resumed(self, kept: Checkpoint[State]) -> Point[State]:
        self.search, place = replace(kept), kept.current
        point = self._evaluate(place.parameters, place.state, place.closing)
        self.search.evaluations -= self.merit.evaluations
        return point

    @overflowing
    def _evaluate(
        self,
        parameters: Array,
        state: State,
        closing: float | None = None,
        contraction: float = 1.0,
        trial: bool = False,
    ) -> Point[State]:
        evaluation = self.merit.evaluate(
            parameters,
            state,
            triangular=self.search.triangular,
            closing=closing,
            contraction=contraction,
            trial=trial,
        )
        return self._point(parameters, evaluation)

    def _point(self, parameters: Array, evaluation: Evaluation[State]) -> Point[State]:
        merit = evaluation.cost + self.unknowns.prior_square(parameters)
        bad = not math.isfinite(merit) or bool(evaluation.late) or bool(evaluation.singular)
        system = None
        if evaluation.finite:
            offset = self.unknowns.offset(parameters)
            system = spectrum(evaluation.data, offset, self.unknowns.prior_sd)
        return Point(parameters, evaluation, np.inf if bad else merit, system, evaluation.closing)

    def _advance(self, current: Point[State]) -> Point[State] | None:
        """The next accepted point; None where no step is accepted."""
        if (fast := self._fast(current)) is not None:
            return fast
        while self.search.course.damping < MOST_DAMPING:
            system = current.spectrum
            assert system is not None
            predicted = system.predicted(self.search.course.damping)
            if (descent := self._try(current, predicted)) is not None:
                trial, move = descent
                gain = (current.merit - trial.merit) / predicted if predicted > 0 else 1.0
                self.search.course = self.search.course.accepted(system, move, gain)
                return trial
            # The merit of open loops is an estimate: close them as well as the trial's.
            closing = _CLOSED if self._last(current, predicted) else _NEAR
            if current.evaluation.step > closing and (current.closed or np.inf) > closing:
                closed = self._evaluate(current.parameters, current.evaluation.proposal, closing)
                if math.isfinite(closed.merit) and closed.spectrum is not None:
                    current = closed
                    continue
                current = replace(current, closed=closing)
            self.search.course = self.search.course.rejected(system)
        return None

    def _fast(self, current: Point[State]) -> Point[State] | None:
        """The point after an accelerated step; None where there is none that descends.

        Steps are accelerated near the end, where they no longer shrink by much.
        """
        system, slow = current.spectrum, _SLOW * self.search.before
        recent = self.search.course.recent
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
            start, contraction = current.evaluation.proposal, current.evaluation.contraction
            trial = self._evaluate(parameters, start, closing, contraction, trial=True)
            if self._worth(current, trial, system.decrement):
                # A gain below zero is rounding here, no reason to raise the damping.
                gain = (current.merit - trial.merit) / system.decrement
                self.search.course = self.search.course.accepted(system, step, max(gain, 0.0))
                return trial
        self.search.course = self.search.course.unaccelerated()
        return None

    def _try(self, current: Point[State], predicted: float) -> tuple[Point[State], Array] | None:
        """The point after a step, corrected or not, if its merit falls as it should, and the move
        (n,) [SI] that led there; else None."""
        assert current.spectrum is not None
        damping, scale = self.search.course.damping, current.spectrum.scale
        move = step = current.spectrum.step(damping)
        far, last = self._far(current, predicted), self._last(current, predicted)
        closings = [None, _NEAR] if far else [_CLOSED] if last or self._wide else [_ONCE, _NEAR]
        at, least = current, _GAIN
        state = current.evaluation.state if far else current.evaluation.proposal
        for _ in range(1 if far else 1 + _CORRECTIONS):
            parameters = self.unknowns.moved(current.parameters, move)
            for closing in closings:
                trial = self._evaluate(
                    parameters, state, closing, at.evaluation.contraction, trial=True
                )
                if self._worth(current, trial, predicted, least):
                    return trial, move
                if trial.evaluation.late or trial.evaluation.step <= _CLOSED:
                    break  # what is still open cannot close, or nothing is
            if trial.spectrum is None or not math.isfinite(trial.merit):
                return None
            before, step = step, trial.spectrum.step(damping, after=move)
            if not np.linalg.norm(step / scale) <= _SHRINK * np.linalg.norm(before / scale):
                return None
            at, state, move = trial, trial.evaluation.proposal, move + step
            least = _GAIN_CORRECTED
        return None

    def _far(self, point: Point[State], predicted: float) -> bool:
        """Whether parameters explain nearly all of a large misclosure: then readings can wait."""
        return predicted > max(_EXPLAINED * point.merit, _FAR * point.evaluation.equations)

    @property
    def _wide(self) -> bool:
        """Whether a sweep costs so much that none should be made only to close the loops."""
        return len(self.unknowns.free) >= _WIDE

    def _last(self, point: Point[State], predicted: float) -> bool:
        """Whether the step from a point is so small that the next point should be final."""
        return predicted <= self._limit(point, _LAST_STEP)

    def _worth(
        self, current: Point[State], trial: Point[State], predicted: float, least: float = _GAIN
    ) -> bool:
        if not math.isfinite(trial.merit) or trial.spectrum is None:
            return False
        # Each of many residuals E carries a rounding d, so the merit wavers by about 2 |E| |d|.
        wavering = 4 * math.sqrt(current.merit * self.search.floor) + 1e-13 * current.merit
        # The merit cannot show so small a fall: then the next decrement must not have doubled.
        if predicted <= wavering:
            return trial.spectrum.decrement <= 2 * predicted
        return bool(current.merit - trial.merit >= least * predicted - wavering)

    def _settled(self, point: Point[State]) -> bool:
        """Whether the next step leaves nothing beside the sds that the residuals suggest."""
        assert point.spectrum is not None
        decrement, before = point.spectrum.decrement, self.search.before
        if not self._negligible(point):
            return False
        # Linear convergence: the next step leaves a decrement of rate * decrement.
        rate = min(decrement / before, 1.0) if math.isfinite(before) else 1.0
        stuck = math.isfinite(before) and rate > _NO_LONGER
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
        # A step of one sd in each of n independent directions changes chi-squared by n variances.
        variance = point.merit / max(point.evaluation.equations - n, 1)
        return max(step**2 * n * variance, self.search.floor)

    def _converged(self, point: Point[State]) -> End[State]:
        """The end: the last step is taken, and the loops are closed there, without a new sweep.

        The step is too small to change merit or spectrum by more than rounding.
        """
        assert point.spectrum is not None
        parameters = self.unknowns.moved(point.parameters, point.spectrum.step())
        start, contraction = point.evaluation.proposal, point.evaluation.contraction
        closed = self.merit.close(parameters, start, RELATIVE_STEP, contraction)
        reason = "runaway" if self._vanished(point).any() else "converged"
        if closed is None:
            return self._solution(point, reason)
        return self._solution(replace(point, parameters=parameters), reason, closed)

    def _vanished(self, point: Point[State]) -> NDArray[np.bool_]:
        """Parameters (n,) that have run to where they have no effect any more."""
        assert point.spectrum is not None
        return vanished(point.spectrum, point.evaluation.data.lengths, self.search.effects)

    def _stalled(self, current: Point[State]) -> End[State]:
        """The end where no step lowers the merit: given up, unless only rounding is in the way."""
        end = self._evaluate(current.parameters, current.evaluation.proposal, _CLOSED)
        return self._converged(end) if self._negligible(end) else self._give_up(current, "stalled")

    def _give_up(self, current: Point[State], reason: str) -> End[State]:
        end = self._evaluate(current.parameters, current.evaluation.proposal, _CLOSED)
        late = end.evaluation.late
        if late or end.spectrum is None:
            # the merit of open loops is no merit: any point with closed loops is a better end
            end, reason = replace(current, merit=np.inf, closed=None), "cannot_close"
        for place in (self.search.lowest, self.search.first):
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
            gone = np.flatnonzero(self._vanished(end))
            detail = f"Parameters: {', '.join(self.unknowns.names[i] for i in gone)}."
        if reason in ("max_iterations", "stalled", "crept"):
            detail = weakness(hardly_determined(end.spectrum, self.unknowns.names))
        evaluations = self.evaluations / end.evaluation.poses
        if closed is None:
            near = end.evaluation.step <= 1.0  # a longer step may lead anywhere
            closed = end.evaluation.proposal if near else end.evaluation.state
        return End(
            end.parameters,
            closed,
            without_state(end.evaluation),
            end.spectrum,
            self.unknowns.prior_square(end.parameters),
            Status.of(reason, self.search.iterations, evaluations, detail),
        )
