"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

Parameters, covariance, chi-squared and accuracy are those of every pose. The arrays of a result,
one value per pose, are those of poses thinned evenly and of those that fit worst; the arrays of
each chunk are handed out on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.alignment import begins_aligned, placed
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import Result
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.stream.ending import Ending
from loopcal.estimation.stream.pieces import Chunk, Stream, Task, do
from loopcal.estimation.stream.sweeps import StreamMerit, solve_stream
from loopcal.execution.executor import Executor, InProcess
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior

Array = NDArray[np.float64]
Part = TypeVar("Part")
METHODS = ("implicit-loop", "least-squares")


def calibrate_stream(
    mechanism: Mechanism,
    stream: Stream,
    *,
    prior: Prior | None = None,
    method: str = "implicit-loop",
    start: str = "auto",
    begin: dict[str, float] | None = None,
    max_iterations: int = 100,
    executor: Executor | None = None,
    progress: Progress | None = None,
    reached: Callable[[dict[str, float]], None] | None = None,
    part_of: Callable[[Result], Part] | None = None,
    part_done: Callable[[Part], None] | None = None,
) -> Result:
    """Calibrate from more poses than memory holds; memory does not grow with their number.

    stream: its chunks bring data and noise; method, prior and start: as in `calibrate`, with
    methods "implicit-loop" and "least-squares"; begin: parameter values [SI] that an earlier,
    interrupted run had reached; executor: who reads the chunks and does their part of the work, by
    default this process, to the same result to the last bit; reached: called with the values that
    each iteration begins with; part_of: made at the end of the result of each chunk, with all its
    arrays, where the chunk is read (a function at the top of a module); part_done: called here
    with what it made, in the order of the chunks.

    Raises InputError as `calibrate` does, and for what needs all poses at once.
    """
    if not stream.count:
        raise InputError("the stream has no poses", remedy="give one pose at least")
    first = stream.chunk(0)
    _refuse(method, first.noise)
    if prior is not None:
        mechanism = mechanism.with_parameters(prior.apply(mechanism.parameters))
    exact = method == "least-squares"
    if not exact:
        stream = _Disturbed(mechanism, stream)
        mechanism, data = with_model(mechanism, first.data, first.noise)
        first = Chunk(data, first.noise)
    with one_blas_thread():
        task = _task(mechanism, stream, exact=exact)
        if begins_aligned(mechanism, start):
            mechanism, _ = placed(task.problem(first))
            task = _task(mechanism, stream, exact=exact)
        problem = task.problem(first)
        task = _settled(task, problem)

        def told(parameters: Array) -> None:
            if reached:
                names = task.mechanism.parameters.names
                reached(dict(zip(names, parameters.tolist(), strict=True)))

        with (executor or InProcess()).crew(do, task) as crew:
            merit = StreamMerit(task, crew, problem, begin or {})
            solution = solve_stream(
                merit, max_iterations=max_iterations, progress=progress, reached=told
            )
            ending = Ending(task, method, solution)
            return ending.result(crew, merit, part_of, part_done)


def _task(mechanism: Mechanism, stream: Stream, *, exact: bool) -> Task:
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    return Task(mechanism, stream, nominal, exact)


def _settled(task: Task, first: Problem) -> Task:
    """The task with the rounding of loop values, from the first chunk in which a loop holds."""
    task, number = task.settled(first), 1
    while task.rounding is None and number < task.stream.count:
        task, number = task.settled(task.problem(task.stream.chunk(number))), number + 1
    return task


def _refuse(method: str, noise: Noise) -> None:
    if method not in METHODS:
        raise InputError(
            f"the method {method!r} needs all poses in memory, and these come as a stream",
            remedy=f"use {' or '.join(map(repr, METHODS))}, or thin the poses (data.every) and say "
            "stream = false",
        )
    if noise.estimate and method != "least-squares":
        raise InputError(
            "sds are learnt from poses in memory, and these come as a stream",
            remedy="learn them from a part of the poses (data.every, stream = false), and state "
            "them here",
        )


@dataclass(frozen=True, eq=False)
class _Disturbed:
    """A stream with the readings of the machine model's own error, where the noise names it."""

    mechanism: Mechanism
    stream: Stream

    @property
    def poses(self) -> int:
        return self.stream.poses

    @property
    def count(self) -> int:
        return self.stream.count

    def chunk(self, number: int) -> Chunk:
        chunk = self.stream.chunk(number)
        _, data = with_model(self.mechanism, chunk.data, chunk.noise)
        return Chunk(data, chunk.noise)
