"""Calibration of more poses than memory holds: the same solver over chunks that come and go.

A sweep adds up over poses, so it can take them chunk by chunk. Nothing is kept of a pose between
sweeps: its corrections are found again from its readings, which costs an evaluation or two more
and needs no memory. What a sweep returns in their place only says whether the loops were closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.closing import Closed
from loopcal.estimation.problem import Problem, build_problem
from loopcal.estimation.reduction import Accumulator
from loopcal.estimation.scratch import one_blas_thread
from loopcal.estimation.solver import Progress, Solution, solve_with
from loopcal.estimation.starting import start_corrections
from loopcal.estimation.sweep import NEAR, Sweep, Sweeper
from loopcal.expressions.domain import explain_domain
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
AT_READINGS, CLOSED = np.zeros((1, 0)), np.zeros((2, 0))
"""In place of corrections: none, or those that close the loops."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some consecutive poses, and what is said of their noise."""

    data: Dataset
    noise: Noise


class Stream(Protocol):
    """Poses in chunks, as often as they are asked for, the same in each turn; poses: how many."""

    @property
    def poses(self) -> int: ...

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, in order."""


@dataclass(frozen=True)
class StreamedProblem(Problem):
    """A stream as the solver and statistics see it: with some of its poses in memory, or none.

    counted: loop equations of the whole stream; total: its poses.
    """

    counted: int = 0
    total: int = 0

    @property
    def equations(self) -> int:
        """Loop equations over all poses, less the unmeasured quantities they determine."""
        return self.counted

    @property
    def count(self) -> int:
        """How many poses the stream has."""
        return self.total

    def pose(self, number: int) -> str:
        """The number of a pose, from 1."""
        return str(number + 1)


class StreamSweeper(Sweeper):
    """Sweeps over the poses of a stream; lowest: the parameters of the lowest merit so far."""

    def __init__(
        self, problem: StreamedProblem, mechanism: Mechanism, stream: Stream, *, exact: bool
    ) -> None:
        super().__init__(problem, exact=exact)
        self.mechanism, self.stream, self.exact = mechanism, stream, exact
        self.corrects = True  # whether it does is each chunk's own affair
        self.lowest, self._merit = problem.start, np.inf

    def sweep(
        self,
        parameters: Array,
        corrections: Array,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
    ) -> Sweep:
        """One sweep at parameters (n_all,), from the readings of every chunk.

        corrections: AT_READINGS or CLOSED, what closing=None means; contraction says nothing of
        steps that begin anew.
        """
        if closing is None and corrections is CLOSED:
            closing = NEAR
        data = Accumulator(len(self.problem.free), triangular)
        steps, ratios, begin = [0.0], [0.0], 0
        singular: list[NDArray[np.intp]] = []
        late: list[NDArray[np.intp]] = []
        for problem in self._problems():
            own = Sweeper(problem, exact=self.exact)
            own.rounding = self.rounding
            start = start_corrections(own, parameters)
            wanted = NEAR if closing is None and start.any() else closing
            done = own.sweep(parameters, start, triangular=triangular, closing=wanted)
            if self.evaluations == 0 and begin == 0 and not done.finite:
                tape = problem.mechanism.tape
                raise explain_domain(
                    tape, problem.readings, problem.known, parameters, problem.poses
                )
            self.rounding = own.rounding
            self.evaluations += own.evaluations
            data.add_other(done.data)
            steps.append(done.step)
            ratios.append(done.contraction)
            singular.append(done.singular + begin)
            late.append(done.open_poses + begin)
            begin += len(problem.poses)
        found = Sweep(
            data,
            AT_READINGS if closing is None else CLOSED,
            CLOSED,
            max(steps),
            max(ratios),
            np.concatenate(singular),
            np.concatenate(late),
        )
        offset = self.problem.nominal - parameters[self.problem.free]
        merit = found.cost + float(np.square(offset / self.prior_sd).sum())
        if merit <= self._merit:
            self.lowest, self._merit = parameters.copy(), merit
        return found

    def close(
        self, parameters: Array, corrections: Array, tolerance: float, contraction: float
    ) -> Closed:
        """Nothing: the loops of a chunk are closed when its corrections are asked for."""
        return Closed(CLOSED, np.zeros(0, dtype=bool))

    def _problems(self) -> Iterator[Problem]:
        values = dict(
            zip(self.mechanism.parameters.names, self.problem.start.tolist(), strict=True)
        )
        for chunk in self.stream.chunks():
            yield chunk_problem(self.mechanism, chunk, values, exact=self.exact)


def chunk_problem(
    mechanism: Mechanism, chunk: Chunk, start: dict[str, float], *, exact: bool
) -> Problem:
    """The problem of one chunk; that its poses alone determine the parameters is not asked."""
    known = mechanism.with_parameters(mechanism.parameters.with_prior({"*": 1.0}))
    problem = build_problem(known, chunk.data, None if exact else chunk.noise, start)
    prior = {p.name: p.prior_sd for p in mechanism.parameters}
    sds = np.array([prior[name] for name in problem.names])
    return replace(problem, mechanism=mechanism, prior_sd=sds)


def solve_stream(
    mechanism: Mechanism,
    stream: Stream,
    *,
    start: dict[str, float],
    exact: bool = False,
    max_iterations: int = 100,
    progress: Progress | None = None,
    reached: Callable[[Array], None] | None = None,
) -> Solution:
    """The parameters of maximum likelihood from a stream; its corrections are not kept.

    start: parameter values [SI] by name to begin from; reached: called with the parameters
    (n_all,) that each iteration begins with. Raises InputError as `solve` does, and where the
    stream has fewer equations than parameters.
    """
    with one_blas_thread():
        problem = _without_poses(mechanism, stream, start, exact=exact)
        sweeper = StreamSweeper(problem, mechanism, stream, exact=exact)

        def told(iteration: int, merit: float, decrement: float) -> None:
            if reached:
                reached(sweeper.lowest)
            if progress:
                progress(iteration, merit, decrement)

        return solve_with(sweeper, max_iterations=max_iterations, progress=told)


def _without_poses(
    mechanism: Mechanism, stream: Stream, start: dict[str, float], *, exact: bool
) -> StreamedProblem:
    counted = 0
    first: Problem | None = None
    for chunk in stream.chunks():
        problem = chunk_problem(mechanism, chunk, start, exact=exact)
        counted += problem.equations
        first = first or problem
    if first is None:
        raise InputError("the stream has no poses", remedy="give one pose at least")
    informed = 0 if exact else int(np.isfinite(first.prior_sd).sum())
    if counted < len(first.free) - informed:
        raise InputError(
            f"{counted} loop equations ({stream.poses} poses) cannot determine "
            f"{len(first.free) - informed} parameters without prior knowledge",
            remedy="measure more poses, fix parameters, or give them a finite prior sd",
        )
    return StreamedProblem(
        first.mechanism,
        AT_READINGS,
        np.zeros((len(first.known), 0)),
        first.uncertainty,
        first.start,
        first.free,
        first.nominal,
        first.prior_sd,
        (),
        counted=counted,
        total=stream.poses,
    )
