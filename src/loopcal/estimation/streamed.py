"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

Parameters, covariance, chi-squared and accuracy are those of every pose. The arrays of a result,
one value per pose, are those of poses thinned evenly; each chunk's own are handed out on the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.alignment import begins_aligned, placed
from loopcal.estimation.calibrate import result_of
from loopcal.estimation.distances import distances
from loopcal.estimation.learning import with_model
from loopcal.estimation.problem import Problem
from loopcal.estimation.result import Accuracy, Result
from loopcal.estimation.scratch import one_blas_thread
from loopcal.estimation.solver import Progress, Solution
from loopcal.estimation.starting import start_corrections
from loopcal.estimation.stream_pieces import Chunk, Stream, Task, do
from loopcal.estimation.streaming import StreamedProblem, StreamSweeper, solve_stream
from loopcal.estimation.sweep import NEGLIGIBLE
from loopcal.execution.executor import Crew, Executor, InProcess, in_order
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior

Array = NDArray[np.float64]
Part = TypeVar("Part")
METHODS = ("implicit-loop", "least-squares")
SHOWN, WORST = 10_000, 100
"""About so many poses are kept for figures and tests, and at most so many that fit badly."""
_ALIKE = 0.5


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
            sweeper = StreamSweeper(task, crew, problem, begin or {})
            solution = solve_stream(
                sweeper, max_iterations=max_iterations, progress=progress, reached=told
            )
            ending = _Ending(task, method, solution)
            return ending.result(crew, sweeper, part_of, part_done)


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
            remedy=f"use {' or '.join(map(repr, METHODS))}, or thin the poses (data.every)",
        )
    if noise.estimate and method != "least-squares":
        raise InputError(
            "sds are learnt from poses in memory, and these come as a stream",
            remedy="learn them from a part of the poses (data.every) and state them here",
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


@dataclass(frozen=True, eq=False)
class _Ending:
    """The last pass: what became of every pose, at the parameters found."""

    task: Task
    method: str
    solution: Solution

    def result(
        self,
        crew: Crew,
        sweeper: StreamSweeper,
        part_of: Callable[[Result], Part] | None,
        part_done: Callable[[Part], None] | None,
    ) -> Result:
        poses = sum(sweeper.sizes)
        stride = max(1, poses // SHOWN)
        begins = [0, *np.cumsum(sweeper.sizes).tolist()]
        pieces = [
            _EndPiece(number, begins[number], poses, stride, self.solution, self.method, part_of)
            for number in range(self.task.stream.count)
        ]
        accuracies = _Distances(), _Distances()
        kept: list[_Shown] = []
        worst: _Shown | None = None
        with closing(crew(pieces)) as outcomes:
            for ended in in_order(outcomes):
                assert isinstance(ended, _Ended)
                for into, of_chunk in zip(accuracies, ended.distances, strict=True):
                    into.add_other(of_chunk)
                if ended.kept:
                    kept.append(ended.kept)
                if ended.worst:
                    worst = _joined([worst, ended.worst] if worst else [ended.worst]).worst()
                if part_done:
                    part_done(ended.part)
        sample, equations = _joined(kept), sweeper.problem.equations
        # else a few poses make chi-squared what it is
        alike = bool(sample.square.mean() > _ALIKE * self.solution.sweep.cost / poses)
        found = self._shown(sample, equations, poses, alike)
        words = "figures and residuals.csv show"
        told = f"Calibrated from a stream of {poses} poses; {words} {len(found.dataset)} of them"
        if worst:
            everything = self._shown(_joined([sample, worst]).in_order(), equations, poses, alike)
            # those that fit badly say nothing of all the others
            found = replace(
                everything, model_discrepancy=found.model_discrepancy, warnings=found.warnings
            )
            told += f", and {len(worst.number)} more that fit badly"
        before, after = (distance.accuracy() for distance in accuracies)
        return replace(
            found,
            accuracy_before=before,
            accuracy_after=after,
            warnings=(*found.warnings, *([f"{told}."] if stride > 1 else ())),
        )

    def _shown(self, shown: _Shown, equations: int, poses: int, alike: bool) -> Result:
        """The result with the arrays of some poses; alike: whether they misfit as all do."""
        problem = self.task.problem(shown.chunk)
        own = {name: getattr(problem, name) for name in problem.__dataclass_fields__}
        whole = StreamedProblem(**own, counted=equations, total=poses)
        return _closed(self.task, self.method, self.solution, whole, shown.chunk.data, alike)


def _closed(
    task: Task,
    method: str,
    solution: Solution,
    problem: Problem,
    data: Dataset,
    alike: bool = False,
) -> Result:
    """The arrays of some poses, at the parameters of all."""
    sweeper = task.sweeper(problem)
    begun = start_corrections(sweeper, solution.parameters)
    corrections = sweeper.close(solution.parameters, begun, NEGLIGIBLE, 1.0).corrections
    found = replace(solution, corrections=corrections)
    return result_of(method, problem, found, data, alike=alike)


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

    def at(self, index: NDArray[np.intp]) -> _Shown:
        """Some of them, in this order."""
        chunk = Chunk(self.chunk.data.take(index), _some(self.chunk.noise, index))
        return _Shown(self.number[index], self.square[index], self.misfit[index], chunk)

    def in_order(self) -> _Shown:
        """In the order of the stream."""
        return self.at(np.argsort(self.number, kind="stable"))

    def worst(self) -> _Shown:
        """At most WORST of them."""
        return self.at(np.argsort(-self.misfit, kind="stable")[:WORST])


def _joined(parts: list[_Shown]) -> _Shown:
    return _Shown(
        np.concatenate([part.number for part in parts]),
        np.concatenate([part.square for part in parts]),
        np.concatenate([part.misfit for part in parts]),
        _together([part.chunk for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class _Ended:
    """What the last pass found in one chunk: its part, its poses to be shown, its distances.

    kept, worst: None where none of its poses is to be shown, or fits badly.
    """

    part: Any
    kept: _Shown | None
    worst: _Shown | None
    distances: tuple[_Distances, _Distances]


@dataclass(frozen=True, eq=False)
class _EndPiece:
    """The last pass over the chunk of a number, which begins at a pose; every stride-th is kept.

    poses: of the whole stream.
    """

    number: int
    begin: int
    poses: int
    stride: int
    solution: Solution
    method: str
    part_of: Callable[[Result], Any] | None

    def done(self, task: Task) -> _Ended:
        chunk = task.stream.chunk(self.number)
        problem = task.problem(chunk)
        # that the fit converged says nothing of a chunk alone
        solution = replace(self.solution, status=replace(self.solution.status, converged=False))
        result = _closed(task, self.method, solution, problem, chunk.data)
        found = _Distances(), _Distances()
        found[0].add(problem, result.differences_before)
        found[1].add(problem, result.differences_after)
        corrections = np.array(list(result.corrections.values()))
        square, misfit = _misfits(task, problem, self.solution.parameters, corrections, self.poses)
        number = np.arange(self.begin, self.begin + len(chunk.data))
        shown = _Shown(number, square, misfit, chunk)
        every = number % self.stride == 0
        index, bad = np.flatnonzero(every), np.flatnonzero(~every & (misfit > 1.0))
        return _Ended(
            self.part_of(result) if self.part_of else None,
            shown.at(index) if index.size else None,
            shown.at(bad).worst() if bad.size else None,
            found,
        )


def _misfits(
    task: Task, problem: Problem, parameters: Array, corrections: Array, poses: int
) -> tuple[Array, Array]:
    """The weighted squares (N,) of the corrections; and over what one of so many poses exceeds.

    The scale of these is the stated one, or that of the middle pose where it is larger; the
    method of exact sensors has no other.
    """
    from scipy.special import chdtri

    sweeper = task.sweeper(problem)
    sweeper.at(parameters)
    count = len(problem.poses)
    whole, ratio, middle = np.zeros(count), np.zeros(count), np.full(count, np.nan)
    for pattern, some in problem.blocks():
        freedom = len(pattern.loops) - len(pattern.unmeasured)
        if freedom > 0:
            whole[some] = sweeper.misfit(corrections[:, some], pattern, some)
            ratio[some] = whole[some] / float(chdtri(freedom, 1.0 / poses))
            middle[some] = whole[some] / float(chdtri(freedom, 0.5))
    known = np.isfinite(middle)
    scale = float(np.median(middle[known])) if known.any() else 0.0
    scale = scale if task.exact else max(scale, 1.0)
    return whole, ratio / max(scale, 1e-300)


class _Distances:
    """Mean, rms, 95th percentile and maximum of distances that are not kept.

    The percentile comes from counts in bins of 0.2 % width, the first up to SMALLEST.
    """

    SMALLEST, WIDTH, BINS = 1e-12, 0.002, 17_500

    def __init__(self) -> None:
        self.counts = np.zeros(self.BINS, dtype=np.int64)
        self.total = self.squares = self.largest = 0.0
        self.unit = "m"

    def add(self, problem: Problem, differences: Any) -> None:
        mechanism = problem.mechanism
        rows = [mechanism.tape.quantities.index(q) for q in mechanism.outputs]
        found = distances(mechanism, problem.readings[rows], np.array(list(differences.values())))
        if found is None:
            return
        values = found.values[np.isfinite(found.values)]
        self.unit = found.unit
        if not values.size:
            return
        bins = np.ceil(np.log(np.maximum(values / self.SMALLEST, 1.0)) / self.WIDTH)
        bins = np.minimum(bins, self.BINS - 1).astype(np.intp)
        self.counts += np.bincount(bins, minlength=self.BINS)
        self.total += float(values.sum())
        self.squares += float(np.square(values).sum())
        self.largest = max(self.largest, float(values.max()))

    def add_other(self, other: _Distances) -> None:
        self.counts += other.counts
        self.total += other.total
        self.squares += other.squares
        self.largest = max(self.largest, other.largest)
        self.unit = other.unit if other.counts.any() else self.unit

    def accuracy(self) -> Accuracy | None:
        number = int(self.counts.sum())
        if not number:
            return None
        bin_ = int(np.searchsorted(np.cumsum(self.counts), 0.95 * number))
        p95 = min(self.SMALLEST * math.exp(bin_ * self.WIDTH), self.largest)
        rms = float(np.sqrt(self.squares / number))
        return Accuracy(self.unit, self.total / number, rms, p95, self.largest, number)


def _some(noise: Noise, index: NDArray[np.intp]) -> Noise:
    """The noise of some poses."""
    return _of_poses(noise, lambda value: value[index])


def _of_poses(noise: Noise, change: Callable[[Array], Array]) -> Noise:
    """The noise with what is stated pose by pose changed."""
    entries = {
        key: change(value)
        if isinstance(value, np.ndarray) and value.ndim == (3 if isinstance(key, tuple) else 1)
        else value
        for key, value in noise.entries.items()
    }
    return Noise(entries, estimate=noise.estimate)


def _together(parts: list[Chunk]) -> Chunk:
    """Several chunks as one."""
    first = parts[0]

    def joined(pick: Callable[[Chunk], Any]) -> dict[str, Array]:
        return {q: np.concatenate([pick(part)[q] for part in parts]) for q in pick(first)}

    data = Dataset(
        joined(lambda part: part.data.readings),
        first.data.units,
        tuple(pose for part in parts for pose in part.data.poses),
        joined(lambda part: part.data.sds),
        replace(first.data.source, rows=None),
    )
    entries = {
        key: np.concatenate([part.noise.entries[key] for part in parts])
        if isinstance(value, np.ndarray) and value.ndim == (3 if isinstance(key, tuple) else 1)
        else value
        for key, value in first.noise.entries.items()
    }
    return Chunk(data, Noise(entries, estimate=first.noise.estimate))
