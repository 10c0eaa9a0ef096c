"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

The steps are those of a calibration in memory (`loopcal.estimation.steps`), taken with the poses of
the first chunk; the fit then adds up over all chunks. Where sds are learnt, they are from poses
thinned evenly (`loopcal.estimation.stream.learning`). The arrays of a result, one value per pose,
are those of such poses and of those that fit worst; the arrays of each chunk are handed out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import Result
from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.robust import FIRST_STAGE, Stage, in_stages, summed
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import NEAR
from loopcal.estimation.steps import State, examined, fitted, placed, prepared
from loopcal.estimation.stream.chunks import Stream
from loopcal.estimation.stream.last_pass import LastPass, Parts
from loopcal.estimation.stream.learning import AsFitted, learn
from loopcal.estimation.stream.merit import Ratios, StreamMerit, Task, do
from loopcal.execution.executor import Crew, Executor, InProcess
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


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
) -> Result:
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
