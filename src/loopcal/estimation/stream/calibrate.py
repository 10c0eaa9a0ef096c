"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

Parameters, covariance, chi-squared and accuracy are those of every pose; where sds of terms are
learnt, accuracy alone (`loopcal.estimation.stream.learning`). The arrays of a result,
one value per pose, are those of poses thinned evenly and of those that fit worst; the arrays of
each chunk are handed out on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.calibrate import FAULTY
from loopcal.estimation.faults.search import UNREPAIRED, column_faults
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.model_error import modelled
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.alignment import begun
from loopcal.estimation.problem.parallel_axes import refuse_parallel_axes
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import Result
from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.robust import FIRST_STAGE, Stage, in_stages, summed
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import NEAR
from loopcal.estimation.stream.chunks import Chunk, Disturbed, Stream
from loopcal.estimation.stream.last_pass import LastPass, Parts
from loopcal.estimation.stream.learning import Learnt, Weighed, learn
from loopcal.estimation.stream.merit import StreamMerit, Task, do
from loopcal.execution.executor import Executor, InProcess
from loopcal.measurements.noise import Noise
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
    _refuse_estimates(fit, first.noise)
    made = modelled(fit, fit.with_prior(mechanism), stream.poses)
    exact = fit.solver.exact
    if made.learnt_terms and not exact:
        with one_blas_thread():
            return _learnt(fit, learn(mechanism, stream, fit, progress), stream, executor, parts)
    mechanism = made
    if not exact:
        stream = Disturbed(stream, mechanism)
        mechanism, data = with_model(mechanism, first.data, first.noise)
        first = Chunk(data, first.noise)
    with one_blas_thread():
        task = _task(mechanism, stream, exact=exact)
        mechanism = begun(task.problem(first), fit.start)
        task = _task(mechanism, stream, exact=exact)
        problem = task.problem(first)
        refuse_parallel_axes(mechanism)
        task = _settled(task, problem)
        faults = tuple(
            fault
            for fault in column_faults(problem, suspected=False)
            if fault.code not in UNREPAIRED
        )
        if faults:  # no fit is of use: a short one, so that there is a result to say so
            fit = fit.changed(max_iterations=min(fit.max_iterations, FAULTY))
        with (executor or InProcess()).crew(do, task) as crew:

            def solved(start: Array, loss: Loss | None, stage: Stage) -> End[bool]:
                def kept(checkpoint: Checkpoint[bool]) -> None:
                    if reached:
                        reached(replace(checkpoint, stage=stage.number, earlier=stage.earlier))

                return solve_with(
                    StreamMerit(task, crew, replace(problem, start=start), loss),
                    max_iterations=fit.max_iterations,
                    tolerance=fit.tolerance,
                    progress=progress,
                    reached=kept,
                    resume=resume if resume and resume.stage == stage.number else None,
                )

            def cost() -> float:
                merit = StreamMerit(task, crew, problem, fit.robust_loss)
                at_start = merit.evaluate(problem.start, False, closing=NEAR)
                return summed(at_start, merit.unknowns)

            if (loss := fit.robust_loss) is None:
                solution = solved(problem.start, None, FIRST_STAGE)
            else:
                begin = Stage(resume.stage, resume.earlier) if resume else FIRST_STAGE
                solution = in_stages(solved, problem.start, loss, cost, begin)
            last = LastPass(task, fit, solution, solution.sums.sizes)
            return replace(last.result(crew, parts), faults=faults)


def _learnt(
    fit: Fit, learnt: Learnt, stream: Stream, executor: Executor | None, parts: Parts[Any] | None
) -> Result:
    """The result of a fit to some poses. An interrupted run begins anew."""
    machine = learnt.mechanism
    stream = Disturbed(Weighed(stream, machine, fit, learnt.factors), machine)
    task = _task(machine, stream, exact=False)
    task = _settled(task, task.problem(stream.chunk(0)))
    with (executor or InProcess()).crew(do, task) as crew:
        last = LastPass(task, fit, learnt.end, learnt.sizes)
        return learnt.told(last.result(crew, parts))


def _task(mechanism: Mechanism, stream: Stream, *, exact: bool) -> Task:
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    return Task(mechanism, stream, nominal, exact)


def _settled(task: Task, first: Problem) -> Task:
    """The task with the rounding of loop values, from the first chunk in which a loop holds."""
    task, number = task.settled(first), 1
    while task.rounding is None and number < task.stream.count:
        task, number = task.settled(task.problem(task.stream.chunk(number))), number + 1
    return task


def refuse_unstreamable(fit: Fit) -> None:
    """Raise InputError for settings that need all poses in memory."""
    if not fit.method.streamable:
        known = " or ".join(map(repr, names_where("streamable")))
        raise InputError(
            f"the method {fit.method.name!r} needs all poses in memory, but they are read as a "
            f"stream",
            code="unsupported",
            remedy=f"use {known}, or thin the poses (data.every) and set stream = false",
        )
    if not isinstance(fit.start, str):
        raise InputError(
            "starting from parameter values needs all poses in memory, but they are read as a "
            "stream",
            code="unsupported",
            remedy="leave it out, or thin the poses (data.every) and set stream = false",
        )


def _refuse_estimates(fit: Fit, noise: Noise) -> None:
    if noise.estimate and not fit.method.exact:
        raise InputError(
            "estimating sds needs all poses in memory, but they are read as a stream",
            code="unsupported",
            remedy="estimate them from thinned poses (data.every, stream = false) and state the "
            "result here",
        )
