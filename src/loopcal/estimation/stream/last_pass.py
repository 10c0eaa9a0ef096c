"""The last pass over a stream: what became of every pose, and the result that shows some."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.estimation.accuracy import AccuracyTally
from loopcal.estimation.all_poses import AllPoses
from loopcal.estimation.fit import Fit
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.robust import RobustSums
from loopcal.estimation.solve.solution import End
from loopcal.estimation.stream.merit import Chunk, Task, joined
from loopcal.execution.executor import Crew, in_order
from loopcal.measurements.dataset import Dataset

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
"""About so many poses are kept for figures and tests; a model error is told of where these misfit
at least this share of what all do."""


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
