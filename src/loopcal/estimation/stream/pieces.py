"""A stream chunk by chunk: what all pieces of its work share, and one chunk's part of a sweep.

Each piece reads its own chunk, wherever it is done, and hands back sums, so that nothing of a pose
travels. What it finds depends on nothing but its number and what it is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.problem.unreachable import refuse_unreachable
from loopcal.estimation.solve.merit import Evaluation, without_state
from loopcal.estimation.solve.scratch import one_blas_thread, reuse_memory
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.expressions.domain import explain_domain
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some consecutive poses, and what is said of their noise."""

    data: Dataset
    noise: Noise


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


@dataclass(frozen=True, eq=False)
class Task:
    """What all pieces share.

    start: nominal parameter values [SI]; exact: of the basic method; rounding: of loop values,
    the same for all chunks (`Sweeper.rounding`).
    """

    mechanism: Mechanism
    stream: Stream
    start: Mapping[str, float]
    exact: bool
    rounding: float | None = None

    def problem(self, chunk: Chunk) -> Problem:
        """The problem of one chunk; that its poses alone determine the parameters is not asked."""
        noise = None if self.exact else chunk.noise
        return build_problem(self.mechanism, chunk.data, noise, self.start, whole=False)

    def sweeper(self, problem: Problem) -> Sweeper:
        """What sweeps over the poses of one chunk."""
        made = Sweeper(problem, exact=self.exact)
        made.rounding = self.rounding
        return made

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


@dataclass(frozen=True, eq=False)
class Swept:
    """What a sweep found in one chunk, and the loop evaluations it took."""

    found: Evaluation[None]
    evaluations: int


@dataclass(frozen=True, eq=False)
class SweepPiece:
    """One sweep over the chunk of a number; first: of all, where readings are looked at."""

    number: int
    parameters: Array
    triangular: bool
    closing: float | None
    first: bool

    def done(self, task: Task) -> Swept:
        """The chunk's sums.

        Raises InputError where the first sweep meets what the machine cannot have read, or, as
        DomainError, no number.
        """
        problem = task.problem(task.stream.chunk(self.number))
        if self.first:
            refuse_unreachable(problem, problem.start)
        sweeper = task.sweeper(problem)
        start = start_corrections(sweeper, self.parameters)
        wanted = NEAR if self.closing is None and start.any() else self.closing
        found = sweeper.sweep(self.parameters, start, triangular=self.triangular, closing=wanted)
        if self.first and not found.finite:
            raise explain_domain(
                problem.mechanism.tape,
                problem.readings,
                problem.known,
                self.parameters,
                problem.poses,
                problem.mechanism.remedies,
            )
        return Swept(without_state(found), sweeper.evaluations)
