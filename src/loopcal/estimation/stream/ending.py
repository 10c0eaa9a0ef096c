"""The last pass over a stream: what became of every pose, and the result that shows some."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.accuracy_tally import AccuracyTally
from loopcal.estimation.fit import Fit
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.result import AllPoses, Result
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.sweep import NEGLIGIBLE
from loopcal.estimation.stream.pieces import Task
from loopcal.estimation.stream.shown import Shown, joined, misfits
from loopcal.estimation.stream.sweeps import StreamedProblem, StreamMerit
from loopcal.execution.executor import Crew, in_order
from loopcal.measurements.dataset import Dataset

Array = NDArray[np.float64]
Part = TypeVar("Part")
SHOWN, _ALIKE = 10_000, 0.5
"""About so many poses are kept for figures and tests; a model error is told of where these misfit
at least this share of what all do."""


@dataclass(frozen=True, eq=False)
class Parts(Generic[Part]):
    """What to make of each chunk at the end of a stream.

    made: from the result of the chunk with all its arrays, where the chunk is read (a function at
    the top of a module); done: called with it in this process, in the order of the chunks.
    """

    made: Callable[[Result], Part]
    done: Callable[[Part], None]


@dataclass(frozen=True, eq=False)
class Ending:
    """The last pass: what became of every pose, at the parameters found."""

    task: Task
    fit: Fit
    solution: End[bool]

    def result(self, crew: Crew, merit: StreamMerit, parts: Parts[Any] | None) -> Result:
        poses = sum(merit.sizes)
        stride, made = max(1, poses // SHOWN), parts.made if parts else None
        begins = [0, *np.cumsum(merit.sizes).tolist()]
        pieces = [
            _EndPiece(number, begins[number], poses, stride, self.solution, self.fit, made)
            for number in range(self.task.stream.count)
        ]
        accuracies = AccuracyTally(), AccuracyTally()
        kept: list[Shown] = []
        worst: Shown | None = None
        with closing(crew(pieces)) as outcomes:
            for ended in in_order(outcomes):
                assert isinstance(ended, _Ended)
                for into, of_chunk in zip(accuracies, ended.distances, strict=True):
                    into.add_other(of_chunk)
                if ended.kept:
                    kept.append(ended.kept)
                if ended.worst:
                    worst = joined([worst, ended.worst] if worst else [ended.worst]).worst()
                if parts:
                    parts.done(ended.part)
        sample, equations = joined(kept), merit.equations
        # else a few poses make chi-squared what it is
        alike = bool(sample.square.mean() > _ALIKE * self.solution.cost / poses)
        found = self._shown(sample, equations, poses)
        words = "figures and residuals.csv show"
        told = f"Calibrated from a stream of {poses} poses; {words} {len(found.dataset)} of them"
        discrepancy = found.model_discrepancy if alike else None
        if worst:
            # those that fit badly say nothing of all the others
            found = self._shown(joined([sample, worst]).in_order(), equations, poses)
            told += f", and {len(worst.number)} more that fit badly"
        before, after = (distance.accuracy() for distance in accuracies)
        return replace(
            found,
            all_poses=AllPoses(before, after, discrepancy),
            notes=(f"{told}.",) if stride > 1 else (),
        )

    def _shown(self, shown: Shown, equations: int, poses: int) -> Result:
        """The result with the arrays of some poses."""
        problem = self.task.problem(shown.chunk)
        own = {name: getattr(problem, name) for name in problem.__dataclass_fields__}
        whole = StreamedProblem(**own, counted=equations, total=poses)
        return _closed(self.task, self.fit, self.solution, whole, shown.chunk.data)


def _closed(task: Task, fit: Fit, solution: End[bool], problem: Problem, data: Dataset) -> Result:
    """The arrays of some poses, at the parameters of all."""
    sweeper = task.sweeper(problem)
    begun = start_corrections(sweeper, solution.parameters)
    corrections = sweeper.close(solution.parameters, begun, NEGLIGIBLE, 1.0).corrections
    return Result(fit, data, problem, solution.with_state(corrections), problem)


@dataclass(frozen=True, eq=False)
class _Ended:
    """What the last pass found in one chunk: its part, its poses to be shown, its distances.

    kept, worst: None where none of its poses is to be shown, or fits badly.
    """

    part: Any
    kept: Shown | None
    worst: Shown | None
    distances: tuple[AccuracyTally, AccuracyTally]


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
    part_of: Callable[[Result], Any] | None

    def done(self, task: Task) -> _Ended:
        chunk = task.stream.chunk(self.number)
        problem = task.problem(chunk)
        # that the fit converged says nothing of a chunk alone
        solution = replace(self.solution, status=replace(self.solution.status, converged=False))
        result = _closed(task, self.fit, solution, problem, chunk.data)
        found = AccuracyTally(), AccuracyTally()
        found[0].add(result.deviations(result.differences_before))
        found[1].add(result.deviations(result.differences_after))
        corrections = np.array(list(result.corrections.values()))
        square, misfit = misfits(task, problem, self.solution.parameters, corrections, self.poses)
        number = np.arange(self.begin, self.begin + len(chunk.data))
        shown = Shown(number, square, misfit, chunk)
        every = number % self.stride == 0
        index, bad = np.flatnonzero(every), np.flatnonzero(~every & (misfit > 1.0))
        return _Ended(
            self.part_of(result) if self.part_of else None,
            shown.at(index) if index.size else None,
            shown.at(bad).worst() if bad.size else None,
            found,
        )
