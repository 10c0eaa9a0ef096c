"""The result of a calibration from a stream: its parameters from all poses, its arrays from some.

Parameters, covariance, chi-squared and accuracy are those of every pose. The arrays of a result,
one value per pose, are those of poses thinned evenly; each chunk's own are handed out on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

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
from loopcal.estimation.streaming import (
    Chunk,
    Stream,
    StreamedProblem,
    chunk_problem,
    solve_stream,
)
from loopcal.estimation.sweep import NEGLIGIBLE, Sweeper
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior

Array = NDArray[np.float64]
METHODS = ("implicit-loop", "least-squares")
SHOWN = 10_000
"""About so many poses are kept for figures and tests."""


def calibrate_stream(
    mechanism: Mechanism,
    stream: Stream,
    *,
    prior: Prior | None = None,
    method: str = "implicit-loop",
    start: str = "auto",
    begin: dict[str, float] | None = None,
    max_iterations: int = 100,
    progress: Progress | None = None,
    reached: Callable[[dict[str, float]], None] | None = None,
    chunk_done: Callable[[Result], None] | None = None,
) -> Result:
    """Calibrate from more poses than memory holds; memory does not grow with their number.

    stream: its chunks bring data and noise; method, prior and start: as in `calibrate`, with
    methods "implicit-loop" and "least-squares"; begin: parameter values [SI] that an earlier,
    interrupted run had reached; reached: called with the values that each iteration begins with;
    chunk_done: called with the result of each chunk at the end, in order, with all its arrays.

    Raises InputError as `calibrate` does, and for what needs all poses at once.
    """
    first = next(stream.chunks(), None)
    if first is None:
        raise InputError("the stream has no poses", remedy="give one pose at least")
    _refuse(method, first.noise)
    if prior is not None:
        mechanism = mechanism.with_parameters(prior.apply(mechanism.parameters))
    exact = method == "least-squares"
    if not exact:
        bare, stream = mechanism, _Disturbed(mechanism, stream)
        mechanism, _ = with_model(bare, first.data, first.noise)
        first = next(stream.chunks())
    values = {p.name: p.nominal for p in mechanism.parameters}
    with one_blas_thread():
        if begins_aligned(mechanism, start):
            mechanism, _ = placed(chunk_problem(mechanism, first, values, exact=exact))
            values = {p.name: p.nominal for p in mechanism.parameters}
        names = mechanism.parameters.names

        def told(parameters: Array) -> None:
            if reached:
                reached(dict(zip(names, parameters.tolist(), strict=True)))

        solution = solve_stream(
            mechanism,
            stream,
            start=values | (begin or {}),
            exact=exact,
            max_iterations=max_iterations,
            progress=progress,
            reached=told,
        )
        return _Ending(mechanism, stream, method, values, solution).result(chunk_done)


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

    def chunks(self) -> Iterator[Chunk]:
        for chunk in self.stream.chunks():
            _, data = with_model(self.mechanism, chunk.data, chunk.noise)
            yield Chunk(data, chunk.noise)


@dataclass(eq=False)
class _Ending:
    """The last pass: what became of every pose, at the parameters found."""

    mechanism: Mechanism
    stream: Stream
    method: str
    nominal: dict[str, float]
    solution: Solution
    kept: list[Chunk] = field(default_factory=list)

    def result(self, chunk_done: Callable[[Result], None] | None) -> Result:
        exact = self.method == "least-squares"
        stride = max(1, self.stream.poses // SHOWN)
        accuracies = _Distances(), _Distances()
        counted = begin = 0
        for chunk in self.stream.chunks():
            problem = chunk_problem(self.mechanism, chunk, self.nominal, exact=exact)
            counted += problem.equations
            done = self._closed(problem, chunk.data, converged=False)  # alone it says nothing
            for into, which in zip(
                accuracies, (done.differences_before, done.differences_after), strict=True
            ):
                into.add(problem, which)
            if chunk_done:
                chunk_done(done)
            number = np.arange(begin, begin + len(chunk.data))
            index = np.flatnonzero(number % stride == 0)
            self.kept.append(Chunk(chunk.data.take(index), _some(chunk.noise, index)))
            begin += len(chunk.data)
        sample = _together(self.kept)
        problem = chunk_problem(self.mechanism, sample, self.nominal, exact=exact)
        own = {name: getattr(problem, name) for name in problem.__dataclass_fields__}
        whole = StreamedProblem(**own, counted=counted, total=self.stream.poses)
        found = self._closed(whole, sample.data)
        told = (
            f"Calibrated from a stream of {self.stream.poses} poses; figures, tests of outliers "
            f"and residuals.csv show {len(sample.data)} of them.",
        )
        before, after = (distance.accuracy() for distance in accuracies)
        return replace(
            found,
            accuracy_before=before,
            accuracy_after=after,
            warnings=(*found.warnings, *(told if stride > 1 else ())),
        )

    def _closed(self, problem: Problem, data: Dataset, *, converged: bool = True) -> Result:
        """The arrays of some poses, at the parameters of all."""
        parameters = self.solution.parameters
        sweeper = Sweeper(problem, exact=self.method == "least-squares")
        begun = start_corrections(sweeper, parameters)
        corrections = sweeper.close(parameters, begun, NEGLIGIBLE, 1.0).corrections
        status = self.solution.status
        status = replace(status, converged=status.converged and converged)
        solution = replace(self.solution, corrections=corrections, status=status)
        return result_of(self.method, problem, solution, data)


class _Distances:
    """Mean, rms, 95th percentile and maximum of distances that are not kept.

    The percentile comes from counts in bins of 0.2 % width.
    """

    EDGES = np.geomspace(1e-12, 1e3, 17_500)

    def __init__(self) -> None:
        self.counts = np.zeros(len(self.EDGES) + 1, dtype=np.int64)
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
        np.add.at(self.counts, np.searchsorted(self.EDGES, values), 1)
        self.total += float(values.sum())
        self.squares += float(np.square(values).sum())
        self.largest = max(self.largest, float(values.max()))

    def accuracy(self) -> Accuracy | None:
        number = int(self.counts.sum())
        if not number:
            return None
        bin_ = int(np.searchsorted(np.cumsum(self.counts), 0.95 * number))
        p95 = min(float(self.EDGES[min(bin_, len(self.EDGES) - 1)]), self.largest)
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
