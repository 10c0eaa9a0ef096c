"""Calibration of more poses than memory holds: the same solver over chunks that come and go.

A sweep adds up over poses, so it can take them chunk by chunk. Nothing is kept of a pose between
sweeps: its corrections are found again from its readings, which costs an evaluation or two more
and needs no memory. What a sweep returns in their place only says whether the loops were closed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.fit import Fit
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.closing import Closed
from loopcal.estimation.solve.reduction import Accumulator
from loopcal.estimation.solve.solver import Progress, Solution, solve_with
from loopcal.estimation.solve.sweep import NEAR, Sweep, Sweeper
from loopcal.estimation.stream.pieces import SweepPiece, Swept, Task
from loopcal.execution.executor import Crew, in_order

Array = NDArray[np.float64]
AT_READINGS, CLOSED = np.zeros((1, 0)), np.zeros((2, 0))
"""In place of corrections: none, or those that close the loops."""


@dataclass(frozen=True)
class StreamedProblem(Problem):
    """A stream as the solver and statistics see it: with some of its poses in memory, or none.

    counted: loop equations of the whole stream; total: its poses; named: the ids of some.
    """

    counted: int = 0
    total: int = 0
    named: Mapping[int, str] = field(default_factory=dict)

    @property
    def equations(self) -> int:
        """Loop equations over all poses, less the unmeasured quantities they determine."""
        return self.counted

    @property
    def count(self) -> int:
        """How many poses the stream has."""
        return self.total

    def pose(self, number: int) -> str:
        """The id of a pose, where it is known, else its number from 1."""
        return self.named.get(number, str(number + 1))


class StreamSweeper(Sweeper):
    """Sweeps over the poses of a stream, its chunks done by a crew and added up in their order.

    first: the problem of the first chunk; begin: parameter values [SI] to begin from, where not
    the nominal ones. lowest: the parameters of the lowest merit so far; sizes: poses of each
    chunk, known from the first sweep on.
    """

    def __init__(self, task: Task, crew: Crew, first: Problem, begin: Mapping[str, float]) -> None:
        super().__init__(_without_poses(task, first, begin), exact=task.exact)
        self.task, self.crew = task, crew
        self.rounding = task.rounding
        self.corrects = True  # whether it does is each chunk's own affair
        self.sizes: list[int] = []
        self.lowest, self._merit = self.problem.start, np.inf

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
        data = Accumulator(len(self.problem.free), triangular, self._units)
        parts = [
            SweepPiece(number, parameters, triangular, closing, first=not self.sizes)
            for number in range(self.task.stream.count)
        ]
        steps, ratios, begin, equations = [0.0], [0.0], 0, 0
        sizes: list[int] = []
        named: dict[int, str] = {}
        singular: list[NDArray[np.intp]] = []
        late: list[NDArray[np.intp]] = []
        with contextlib.closing(self.crew(parts)) as outcomes:
            for part in in_order(outcomes):
                assert isinstance(part, Swept)
                data.add_other(part.data)
                steps.append(part.step)
                ratios.append(part.contraction)
                singular.append(part.singular + begin)
                late.append(part.open_poses + begin)
                named |= {number + begin: pose for number, pose in part.named.items()}
                sizes.append(part.poses)
                begin += part.poses
                equations += part.equations
                self.evaluations += part.evaluations
        if not self.sizes:
            self._count(sizes, equations)
        if named:
            assert isinstance(self.problem, StreamedProblem)
            self.problem = replace(self.problem, named=named)
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

    def _count(self, sizes: list[int], equations: int) -> None:
        """Keep what the first sweep has counted. Raises InputError for too few equations."""
        assert isinstance(self.problem, StreamedProblem)
        problem, poses = self.problem, sum(sizes)
        self.sizes = sizes
        self.problem = replace(problem, counted=equations, total=poses)
        informed = 0 if self.task.exact else int(np.isfinite(problem.prior_sd).sum())
        needed = len(problem.free) - informed
        if equations < needed:
            raise InputError(
                f"{equations} loop equations ({poses} poses) cannot determine {needed} parameters "
                "without prior knowledge",
                remedy="measure more poses, fix parameters, or give them a finite prior sd",
            )


def solve_stream(
    sweeper: StreamSweeper,
    *,
    fit: Fit,
    progress: Progress | None = None,
    reached: Callable[[Array], None] | None = None,
) -> Solution:
    """The parameters of maximum likelihood from a stream; its corrections are not kept.

    reached: called with the parameters (n_all,) that each iteration begins with. Raises InputError
    as `solve` does, and where the stream has fewer equations than parameters.
    """

    def told(iteration: int, merit: float, decrement: float) -> None:
        if reached:
            reached(sweeper.lowest)
        if progress:
            progress(iteration, merit, decrement)

    return solve_with(
        sweeper, max_iterations=fit.max_iterations, tolerance=fit.tolerance, progress=told
    )


def _without_poses(task: Task, first: Problem, begin: Mapping[str, float]) -> StreamedProblem:
    names = task.mechanism.parameters.names
    values = dict(zip(names, first.start.tolist(), strict=True)) | dict(begin)
    return StreamedProblem(
        first.mechanism,
        AT_READINGS,
        np.zeros((len(first.known), 0)),
        first.uncertainty,
        np.array([values[name] for name in names]),
        first.free,
        first.nominal,
        first.prior_sd,
        (),
        total=task.stream.poses,
    )
