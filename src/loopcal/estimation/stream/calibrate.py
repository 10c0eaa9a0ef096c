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
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit, used_noise, weighed
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.robust import FIRST_STAGE, Stage, in_stages, summed
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import NEAR
from loopcal.estimation.steps import State, examined, fitted, placed, prepared
from loopcal.estimation.stream.last_pass import LastPass, Parts
from loopcal.estimation.stream.merit import Chunk, Ratios, Stream, StreamMerit, Task, do, joined
from loopcal.execution.executor import Crew, Executor, InProcess
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
        part = replace(part, noise=part.noise.begun_at({}))  # as near as those of nearly the same
    options: dict[str, Any] = {"noise": part.noise, "fit": fit, "progress": progress}
    return Learnt(calibrate(mechanism, part.data, **options), every, tuple(sizes))
