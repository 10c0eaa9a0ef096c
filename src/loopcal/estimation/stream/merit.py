"""The merit over a stream: the same solver over chunks that come and go.

An evaluation adds up over poses, so it can take them chunk by chunk. Each piece of work reads its
own chunk, wherever it is done, and returns sums; it depends on nothing but its number and what it
is given. Nothing is kept of a pose between evaluations: its corrections are found again from its
readings, which costs an evaluation or two more and needs no memory.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.noise.estimation import scaled
from loopcal.estimation.problem.problem import Problem, Weighting, build_problem, refuse_too_few
from loopcal.estimation.problem.starting import refuse_unreachable, start_corrections
from loopcal.estimation.solve.in_memory import cannot_close, outside_domain
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import Evaluation, Failed, without_state
from loopcal.estimation.solve.reduction import Accumulator
from loopcal.estimation.solve.scratch import one_blas_thread, reuse_memory
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.execution.executor import Crew, in_order
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Ratios = Sequence[tuple[Sequence[int], float]]
"""Positions of quantities, and by how much their variances are multiplied."""


@dataclass(frozen=True, eq=False)
class Task:
    """What all pieces share.

    weighting: what the loops count; ratios:
    learnt over stated variance of some quantities; rounding: of loop values,
    the same for all chunks (`Sweeper.rounding`).
    """

    mechanism: Mechanism
    stream: Stream
    weighting: Weighting
    ratios: Ratios = ()
    rounding: float | None = None

    def problem(self, chunk: Chunk) -> Problem:
        """The problem of one chunk, whose poses alone need not determine the parameters."""
        noise = None if self.weighting is Weighting.ALIKE else chunk.noise
        problem = build_problem(self.mechanism, chunk.data, noise, whole=False)
        return scaled(problem, [q for q, _ in self.ratios], np.array([r for _, r in self.ratios]))

    def sweeper(self, problem: Problem, loss: Loss | None = None) -> Sweeper:
        """What sweeps over the poses of one chunk."""
        return Sweeper(problem, loss=loss, rounding=self.rounding)

    def settled(self, problem: Problem) -> Task:
        """The same with the rounding that the first chunk shows, at the parameters it starts at."""
        sweeper = self.sweeper(problem)
        sweeper.sweep(problem.start, start_corrections(sweeper, problem.start))
        return replace(self, rounding=sweeper.rounding)


class StreamPiece(Protocol):
    """The work of one chunk."""

    def done(self, task: Task) -> Any:
        """What becomes of it."""


def do(task: Task, piece: StreamPiece) -> Any:
    """Do a piece: the work of an executor."""
    reuse_memory(32)
    with one_blas_thread():
        return piece.done(task)


class StreamMerit:
    """The merit over the poses of a stream, its chunks evaluated by a crew and added in order.

    Its state says whether loops are closed; corrections are found anew from the readings. first:
    the problem of the first chunk.
    """

    def __init__(self, task: Task, crew: Crew, first: Problem, loss: Loss | None = None) -> None:
        self.unknowns = first.unknowns
        self.task, self.crew, self.loss = task, crew, loss
        self.evaluations = 0
        self._units = first.units

    def first(self, parameters: Array) -> Evaluation[bool]:
        """The evaluation to begin from.

        Raises InputError where a loop has no value or cannot be corrected, and for too few
        equations.
        """
        evaluation = self._evaluated(parameters, triangular=False, closing=None, first=True)
        if evaluation.singular:
            raise cannot_close(evaluation.singular)
        refuse_too_few(evaluation.equations, evaluation.poses, self.unknowns)
        return evaluation

    def evaluate(
        self,
        parameters: Array,
        state: bool,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
        trial: bool = False,
    ) -> Evaluation[bool]:
        """The evaluation at parameters (n_all,), from the readings of every chunk.

        contraction is not used: it says nothing of steps that begin anew. Nor is trial: chunks do
        not know of one another.
        """
        # Corrections are not kept, so loops that were closed have to be closed anew.
        closing = NEAR if closing is None and state else closing
        return self._evaluated(parameters, triangular=triangular, closing=closing)

    def close(
        self, parameters: Array, state: bool, tolerance: float, contraction: float
    ) -> bool | None:
        """Nothing to do: the loops of a chunk are closed when its corrections are asked for."""
        return True

    def nearer(self, parameters: Array, state: bool) -> bool | None:
        """None: loops are closed from the readings in every pass, with no second look."""
        return None

    def _evaluated(
        self, parameters: Array, *, triangular: bool, closing: float | None, first: bool = False
    ) -> Evaluation[bool]:
        data = Accumulator(len(self.unknowns.free), triangular, self._units)
        parts = [
            _SweepPiece(number, parameters, triangular, closing, first, self.loss)
            for number in range(self.task.stream.count)
        ]
        step = contraction = rounding = surplus = 0.0
        equations, sizes, singular, late = 0, list[int](), Failed(), Failed()
        with contextlib.closing(self.crew(parts)) as outcomes:
            # Sums are rounded: only one order gives the same last bit for every number of workers.
            for part in in_order(outcomes):
                assert isinstance(part, _Swept)
                evaluation = part.evaluation
                data.add_other(evaluation.data)
                step, contraction = (
                    max(step, evaluation.step),
                    max(contraction, evaluation.contraction),
                )
                rounding = evaluation.rounding
                singular, late = singular + evaluation.singular, late + evaluation.late
                surplus += evaluation.surplus
                sizes.append(evaluation.poses)
                equations += evaluation.equations
                self.evaluations += part.evaluations
        return Evaluation(
            data,
            state=closing is not None,
            proposal=True,
            step=step,
            contraction=contraction,
            closing=closing,
            rounding=rounding,
            equations=equations,
            sizes=tuple(sizes),
            singular=singular,
            late=late,
            surplus=surplus,
        )


@dataclass(frozen=True, eq=False)
class _Swept:
    """What a sweep found in one chunk, and the loop evaluations it took."""

    evaluation: Evaluation[None]
    evaluations: int


@dataclass(frozen=True, eq=False)
class _SweepPiece:
    """One sweep over the chunk of a number; first: of all, where readings are looked at."""

    number: int
    parameters: Array
    triangular: bool
    closing: float | None
    first: bool
    loss: Loss | None

    def done(self, task: Task) -> _Swept:
        """The chunk's sums.

        Raises InputError where the first sweep meets what the machine cannot have read, or, as
        DomainError, no number.
        """
        problem = task.problem(task.stream.chunk(self.number))
        if self.first:
            refuse_unreachable(problem, problem.start)
        sweeper = task.sweeper(problem, self.loss)
        start = start_corrections(sweeper, self.parameters)
        wanted = NEAR if self.closing is None and start.any() else self.closing
        evaluation = sweeper.sweep(
            self.parameters, start, triangular=self.triangular, closing=wanted
        )
        if self.first and not evaluation.finite:
            raise outside_domain(problem, self.parameters)
        return _Swept(without_state(evaluation), sweeper.evaluations)


# Poses in chunks: what a stream brings, and some of its poses taken or joined.


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some consecutive poses, and what is stated of their noise."""

    data: Dataset
    noise: Noise

    def take(self, index: NDArray[np.intp]) -> Chunk:
        """Some of the poses, in this order."""
        return Chunk(self.data.take(index), self.noise.take(index))


def joined(parts: Sequence[Chunk]) -> Chunk:
    """Several chunks as one."""
    first = parts[0]

    def all_of(pick: Callable[[Chunk], Any]) -> dict[str, Array]:
        return {q: np.concatenate([pick(part)[q] for part in parts]) for q in pick(first)}

    data = Dataset(
        all_of(lambda part: part.data.readings),
        first.data.units,
        tuple(pose for part in parts for pose in part.data.poses),
        all_of(lambda part: part.data.sds),
        replace(first.data.source, rows=None),
    )
    return Chunk(data, first.noise.before([part.noise for part in parts[1:]]))


class Stream(Protocol):
    """Poses in chunks, each as often as it is asked for, the same every time.

    poses: how many; count: how many chunks. Work by processes or on a cluster pickles it: what is
    sent is how to read the poses, not the poses.
    """

    @property
    def poses(self) -> int: ...

    @property
    def count(self) -> int: ...

    def chunk(self, number: int) -> Chunk:
        """The chunk of this number, from 0."""
