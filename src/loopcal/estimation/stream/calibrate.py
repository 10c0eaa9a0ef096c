"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

The steps are those of a calibration in memory (`loopcal.estimation.steps`), taken with the poses of
the first chunk; the fit then adds up over all chunks. Where sds are learnt, they are from poses
thinned evenly (`loopcal.estimation.stream.calibrate`). The arrays of a result, one value per pose,
are those of such poses and of those that fit worst; the arrays of each chunk are handed out.

A stream whose fit learns sds of terms: from poses thinned evenly, in memory, and shown on all.

A pass over all poses with the columns of a model error costs a hundred times as much as one without
them, and learning takes dozens. Some thousand poses say what a machine model lacks; more of them
would lower the part of single readings' noise alone, which is small beside it. The last pass judges
all poses, most of which took no part in the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.errors import InputError
from loopcal.estimation.accuracy import AccuracyTally
from loopcal.estimation.all_poses import AllPoses
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit, used_noise, weighed
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.robust import FIRST_STAGE, RobustSums, Stage, in_stages, summed
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import NEAR
from loopcal.estimation.steps import State, examined, fitted, placed, prepared
from loopcal.estimation.stream.merit import Chunk, Ratios, Stream, StreamMerit, Task, do, joined
from loopcal.execution.executor import Crew, Executor, InProcess, in_order
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def calibrate_stream(
    mechanism: Mechanism,
    stream: Stream,
    *,
    fit: Fit | None = None,
    resume: Checkpoint[bool] | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    reached: Callable[[Checkpoint[bool]], None] | None = None,
    parts: Parts[Any] | None = None,
) -> FitResult:
    """Calibrate from more poses than memory holds; memory does not grow with their number.

    stream: its chunks bring data and noise; fit: the settings, of a streamable method; reached:
    called with a checkpoint at the beginning of each iteration; resume: such a checkpoint of an
    interrupted run, from which this one goes on to the same result to the last bit; executor: who
    reads the chunks and does their part of the work, by default this process, again to the same
    result to the last bit; parts: what to make of each chunk at the end.

    Raises InputError as `calibrate` does, and for what needs all poses at once.
    """
    if not stream.count:
        raise InputError("the stream has no poses", code="no-data", remedy="give at least one pose")
    first, fit = stream.chunk(0), fit or Fit()
    fit = fit.changed(method=fit.among(first.data, first.noise)[0])
    refuse_unstreamable(fit)
    search = _Search(fit, progress, reached, resume)
    with one_blas_thread():
        state = prepared(State(fit, mechanism, first.data, first.noise, stream.poses, whole=False))
        if not state.learns:
            state = examined(placed(state))
            task = _task(state.mechanism, AsFitted(stream, state.mechanism, fit), fit)
            with (executor or InProcess()).crew(do, task) as crew:
                state = fitted(state, partial(search.once, task, crew))
                assert state.end is not None
                result = LastPass(task, fit, state.end, state.end.sums.sizes).result(crew, parts)
            return replace(result, faults=state.faults)
        learnt = learn(mechanism, stream, fit, progress)
        task = _task(learnt.mechanism, AsFitted(stream, learnt.mechanism, fit), fit, learnt.ratios)
        with (executor or InProcess()).crew(do, task) as crew:
            end, sizes = learnt.end, learnt.sizes
            if not learnt.stands_for_all:
                begun = replace(task.problem(task.stream.chunk(0)), start=end.parameters)
                end = search.once(task, crew, begun, fit.max_iterations, fit.tolerance)
            return learnt.annotated(LastPass(task, fit, end, sizes).result(crew, parts))


@dataclass(frozen=True, eq=False)
class _Search:
    """A fit of all chunks: its listeners, and where an interrupted one goes on."""

    fit: Fit
    progress: Progress | None
    reached: Callable[[Checkpoint[bool]], None] | None
    resume: Checkpoint[bool] | None

    def once(
        self, task: Task, crew: Crew, first: Problem, most: int, tolerance: float | None
    ) -> End[bool]:
        """Where the fit ends, from the start of the problem of the first chunk."""
        robust_loss = self.fit.robust_loss

        def solved(start: Array, loss: Loss | None, stage: Stage) -> End[bool]:
            def kept(checkpoint: Checkpoint[bool]) -> None:
                if self.reached:
                    self.reached(replace(checkpoint, stage=stage.number, earlier=stage.earlier))

            return solve_with(
                StreamMerit(task, crew, replace(first, start=start), loss),
                max_iterations=most,
                tolerance=tolerance,
                progress=self.progress,
                reached=kept,
                resume=self.resume if self.resume and self.resume.stage == stage.number else None,
            )

        def cost() -> float:
            merit = StreamMerit(task, crew, first, robust_loss)
            return summed(merit.evaluate(first.start, False, closing=NEAR), merit.unknowns)

        begin = Stage(self.resume.stage, self.resume.earlier) if self.resume else FIRST_STAGE
        return in_stages(solved, first.start, robust_loss, cost, begin)


def _task(mechanism: Mechanism, stream: Stream, fit: Fit, ratios: Ratios = ()) -> Task:
    """With the rounding of loop values, from the first chunk in which a loop holds."""
    task = Task(mechanism, stream, fit.solver.weighting, ratios)
    for number in range(stream.count):
        task = task.settled(task.problem(stream.chunk(number)))
        if task.rounding is not None:
            break
    return task


def refuse_unstreamable(fit: Fit) -> None:
    """Raise InputError for settings that need all poses in memory."""
    if not fit.method.streamable:
        streamable = " or ".join(map(repr, names_where("streamable")))
        raise InputError(
            f"the method {fit.method.name!r} needs all poses in memory, but they are read as a "
            f"stream",
            code="unsupported",
            remedy=f"use {streamable}, or thin the poses (data.every) and set stream = false",
        )
    if not isinstance(fit.start, str):
        raise InputError(
            "starting from parameter values needs all poses in memory, but they are read as a "
            "stream",
            code="unsupported",
            remedy="leave it out, or thin the poses (data.every) and set stream = false",
        )


# docs/decisions/0016.
ENOUGH = 5_000
"""Poses that take part in the fit, at most."""
NEARLY = 1e-2
"""A fit of some of the poses converges to so many sds: others would have moved it by more."""


@dataclass(frozen=True, eq=False)
class AsFitted:
    """A stream with the noise and the readings that a fit of a mechanism uses."""

    stream: Stream
    mechanism: Mechanism
    fit: Fit

    @property
    def poses(self) -> int:
        return self.stream.poses

    @property
    def count(self) -> int:
        return self.stream.count

    def chunk(self, number: int) -> Chunk:
        chunk = self.stream.chunk(number)
        noise = used_noise(self.fit, self.mechanism, chunk.data, chunk.noise)
        if noise is None:
            return chunk
        _, data = with_model(self.mechanism, weighed(self.fit, chunk.data), noise)
        return Chunk(data, noise)


@dataclass(frozen=True, eq=False)
class Learnt:
    """What was learnt from some poses.

    part: their calibration; every: one pose of so many took part; sizes: poses of each chunk.
    """

    part: FitResult
    every: int
    sizes: tuple[int, ...]

    @property
    def mechanism(self) -> Mechanism:
        """With the learnt sds of its terms."""
        return self.part.mechanism

    @property
    def ratios(self) -> Ratios:
        """On the variances of sensors."""
        if (estimate := self.part.estimate) is None:
            return ()
        learnt = zip(estimate.stated, estimate.variances.ratios.tolist(), strict=True)
        return tuple((component.quantities, ratio) for component, ratio in learnt)

    @property
    def stands_for_all(self) -> bool:
        """Whether the fit of these poses stands for all: with terms, a pass over all costs much
        more; and where it failed, that of all would."""
        learns_terms = bool(self.mechanism.learnt_terms)
        return learns_terms or bool(self.part.faults) or not self.part.status.converged

    @property
    def end(self) -> End[bool]:
        """Where the fit of the part ended, as the end of a stream."""
        end = self.part.solution.with_state(True)
        return replace(end, sums=without_state(end.sums))

    def annotated(self, result: FitResult) -> FitResult:
        """The result of all poses, with what was learnt and from how many."""
        part = self.part
        if self.every > 1:
            share = f"{part.solution.poses} of these poses, one of every {self.every}. "
            if self.stands_for_all:
                result = result.noted(f"The fit used {share}The accuracy is that of all poses.")
            else:
                result = result.noted(f"The sds were learnt from {share}The fit used all poses.")
        return replace(result, stated=part.stated, estimate=part.estimate, faults=part.faults)


def learn(
    mechanism: Mechanism, stream: Stream, fit: Fit, progress: Progress | None = None
) -> Learnt:
    """The calibration of at most `ENOUGH` poses of a stream, thinned evenly.

    Raises InputError as `calibrate` does.
    """
    every = -(-stream.poses // ENOUGH)
    parts, sizes = list[Chunk](), list[int]()
    for number in range(stream.count):
        chunk = stream.chunk(number)
        # The stride goes on from chunk to chunk; otherwise each would bring its own first pose.
        thinned = np.arange(-sum(sizes) % every, len(chunk.data), every)
        sizes.append(len(chunk.data))
        if thinned.size:
            parts.append(chunk.take(thinned))
    part = joined(parts)
    if every > 1:
        fit = fit.changed(tolerance=fit.tolerance or NEARLY)
    options: dict[str, Any] = {"noise": part.noise, "fit": fit, "progress": progress}
    return Learnt(calibrate(mechanism, part.data, **options), every, tuple(sizes))


# The last pass over a stream: what became of every pose, and the result that shows some.


Part = TypeVar("Part")
# docs/decisions/0016.
WORST = 100
"""Of the poses that fit badly at most so many are shown."""
NOT_SOUGHT = (
    "In a stream loopcal does not search for copied rows, changes along the run, or residuals that "
    "depend on each other; the sds allow for none of them. Search thinned poses in memory "
    "(data.every, stream = false)."
)
"""What every result of a stream says."""
# Chosen, not derived: a figure shows no more points, and the rms of 10,000 is sure to 0.5 %.
SHOWN, _ALIKE = 10_000, 0.5
"""Poses that are kept for figures and tests. A model error is only reported where they misfit by
at least this share of the misfit of all poses."""


@dataclass(frozen=True, eq=False)
class Parts(Generic[Part]):
    """What to make of each chunk at the end of a stream.

    made: from the result of the chunk with all its arrays, where the chunk is read (a function at
    the top of a module); done: called with it in this process, in the order of the chunks.
    """

    made: Callable[[FitResult], Part]
    done: Callable[[Part], None]


@dataclass(frozen=True, eq=False)
class LastPass:
    """The last pass: what became of every pose, at the parameters found.

    solution: of all poses, or of some; sizes: poses of each chunk.
    """

    task: Task
    fit: Fit
    solution: End[bool]
    sizes: tuple[int, ...]

    def result(self, crew: Crew, parts: Parts[Any] | None) -> FitResult:
        poses, made = sum(self.sizes), parts.made if parts else None
        stride, begins = max(1, poses // SHOWN), [0, *np.cumsum(self.sizes).tolist()]
        pieces = [
            _EndPiece(number, begins[number], poses, stride, self.solution, self.fit, made)
            for number in range(self.task.stream.count)
        ]
        accuracies, robust = (AccuracyTally(), AccuracyTally()), RobustSums({})
        kept: list[_Shown] = []
        worst: _Shown | None = None
        with closing(crew(pieces)) as outcomes:
            for ended in in_order(outcomes):
                assert isinstance(ended, _Ended)
                for into, of_chunk in zip(accuracies, ended.distances, strict=True):
                    into.add_other(of_chunk)
                robust = robust + ended.robust
                if ended.kept:
                    kept.append(ended.kept)
                if ended.worst:
                    # Cut after every chunk, so that memory does not grow with the number of chunks.
                    worst = _joined([worst, ended.worst] if worst else [ended.worst]).worst()
                if parts:
                    parts.done(ended.part)
        sample = _joined(kept)
        # else a few poses make chi-squared what it is
        alike = bool(sample.square.mean() > _ALIKE * self.solution.cost / self.solution.poses)
        shown = self._shown(sample)
        words = "figures and residuals.csv show"
        note = f"Calibrated from a stream of {poses} poses; {words} {len(shown.dataset)} of them"
        discrepancy = shown.model_discrepancy if alike else None
        if worst:
            # those that fit badly say nothing of all the others
            shown = self._shown(_joined([sample, worst]).in_order())
            note += f", and {len(worst.number)} more that fit badly"
        before, after = (distance.accuracy() for distance in accuracies)
        shown = replace(shown, all_poses=AllPoses(poses, before, after, discrepancy, robust))
        return shown.noted(f"{note}.", NOT_SOUGHT) if stride > 1 else shown.noted(NOT_SOUGHT)

    def _shown(self, shown: _Shown) -> FitResult:
        """The result with the arrays of some poses."""
        problem = self.task.problem(shown.chunk)
        return _closed(self.task, self.fit, self.solution, problem, shown.chunk.data)


def _closed(
    task: Task, fit: Fit, solution: End[bool], problem: Problem, data: Dataset
) -> FitResult:
    """The arrays of some poses, at the parameters of all."""
    sweeper = task.sweeper(problem)
    begun = start_corrections(sweeper, solution.parameters)
    corrections = sweeper.close(solution.parameters, begun, NEGLIGIBLE, 1.0).corrections
    return FitResult(fit, data, problem, solution.with_state(corrections), problem)


@dataclass(frozen=True, eq=False)
class _Ended:
    """What the last pass found in one chunk: its part, its poses to be shown, its distances, and
    what the covariance under a loss needs.

    kept, worst: None where none of its poses is to be shown, or fits badly.
    """

    part: Any
    kept: _Shown | None
    worst: _Shown | None
    distances: tuple[AccuracyTally, AccuracyTally]
    robust: RobustSums


@dataclass(frozen=True, eq=False)
class _EndPiece:
    """The last pass over the chunk of a number, which begins at a pose; every stride-th is kept.

    poses: of the whole stream.
    """

    number: int
    begin: int
    poses: int
    stride: int
    solution: End[bool]
    fit: Fit
    part_of: Callable[[FitResult], Any] | None

    def done(self, task: Task) -> _Ended:
        chunk = task.stream.chunk(self.number)
        problem = task.problem(chunk)
        # that the fit converged says nothing of a chunk alone
        solution = replace(self.solution, status=replace(self.solution.status, converged=False))
        result = _closed(task, self.fit, solution, problem, chunk.data)
        tallies = AccuracyTally(), AccuracyTally()
        tallies[0].add(result.deviations(result.differences_before))
        tallies[1].add(result.deviations(result.differences_after))
        corrections = np.array(list(result.corrections.values()))
        square, misfit = _misfits(task, problem, self.solution.parameters, corrections, self.poses)
        number = np.arange(self.begin, self.begin + len(chunk.data))
        shown = _Shown(number, square, misfit, chunk)
        every = number % self.stride == 0
        index, bad = np.flatnonzero(every), np.flatnonzero(~every & (misfit > 1.0))
        return _Ended(
            self.part_of(result) if self.part_of else None,
            shown.take(index) if index.size else None,
            shown.take(bad).worst() if bad.size else None,
            tallies,
            result.robust_sums,
        )


@dataclass(frozen=True, eq=False)
class _Shown:
    """Poses to be shown.

    number: in the stream; square: the weighted square of their corrections; misfit: how badly
    they fit (see `_misfits`).
    """

    number: NDArray[np.intp]
    square: Array
    misfit: Array
    chunk: Chunk

    def take(self, index: NDArray[np.intp]) -> _Shown:
        """Some of them, in this order."""
        chunk = self.chunk.take(index)
        return _Shown(self.number[index], self.square[index], self.misfit[index], chunk)

    def in_order(self) -> _Shown:
        """In the order of the stream."""
        return self.take(np.argsort(self.number, kind="stable"))

    def worst(self) -> _Shown:
        """At most WORST of them."""
        return self.take(np.argsort(-self.misfit, kind="stable")[:WORST])


def _joined(parts: list[_Shown]) -> _Shown:
    """The poses of all parts."""
    return _Shown(
        np.concatenate([part.number for part in parts]),
        np.concatenate([part.square for part in parts]),
        np.concatenate([part.misfit for part in parts]),
        joined([part.chunk for part in parts]),
    )


def _misfits(
    task: Task, problem: Problem, parameters: Array, corrections: Array, poses: int
) -> tuple[Array, Array]:
    """The weighted squares (N,) of the corrections; and over what one of so many poses exceeds.

    The scale of these is the stated one, or that of the middle pose where it is larger; the
    method of exact sensors has no other.
    """
    sweeper = task.sweeper(problem)
    count = len(problem.poses)
    whole, ratio, middle = np.zeros(count), np.zeros(count), np.full(count, np.nan)
    for pattern, block in sweeper.blocks(parameters, corrections):
        some = block.poses
        freedom = len(pattern.loops) - len(pattern.unmeasured)
        if freedom > 0:
            whole[some] = sweeper.misfit(pattern, block)
            ratio[some] = whole[some] / quantile(1.0 / poses, freedom)
            middle[some] = whole[some] / quantile(0.5, freedom)
    finite = np.isfinite(middle)
    scale = float(np.median(middle[finite])) if finite.any() else 0.0
    scale = scale if problem.loops_alike else max(scale, 1.0)
    return whole, ratio / max(scale, 1e-300)
