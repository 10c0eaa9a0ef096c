"""The poses of a stream that a result shows, and how badly each fits."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.chi_squared import quantile
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.stream.pieces import Chunk, Task
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise

Array = NDArray[np.float64]
WORST = 100
"""Of the poses that fit badly at most so many are shown."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Poses to be shown.

    number: in the stream; square: the weighted square of their corrections; misfit: how badly
    they fit (see `misfits`).
    """

    number: NDArray[np.intp]
    square: Array
    misfit: Array
    chunk: Chunk

    def at(self, index: NDArray[np.intp]) -> Shown:
        """Some of them, in this order."""
        chunk = Chunk(self.chunk.data.take(index), _some(self.chunk.noise, index))
        return Shown(self.number[index], self.square[index], self.misfit[index], chunk)

    def in_order(self) -> Shown:
        """In the order of the stream."""
        return self.at(np.argsort(self.number, kind="stable"))

    def worst(self) -> Shown:
        """At most WORST of them."""
        return self.at(np.argsort(-self.misfit, kind="stable")[:WORST])


def joined(parts: list[Shown]) -> Shown:
    """The poses of all parts."""
    return Shown(
        np.concatenate([part.number for part in parts]),
        np.concatenate([part.square for part in parts]),
        np.concatenate([part.misfit for part in parts]),
        _together([part.chunk for part in parts]),
    )


def misfits(
    task: Task, problem: Problem, parameters: Array, corrections: Array, poses: int
) -> tuple[Array, Array]:
    """The weighted squares (N,) of the corrections; and over what one of so many poses exceeds.

    The scale of these is the stated one, or that of the middle pose where it is larger; the
    method of exact sensors has no other.
    """
    sweeper = task.sweeper(problem)
    sweeper.at(parameters)
    count = len(problem.poses)
    whole, ratio, middle = np.zeros(count), np.zeros(count), np.full(count, np.nan)
    for pattern, block in sweeper.blocks(corrections):
        some = block.poses
        freedom = len(pattern.loops) - len(pattern.unmeasured)
        if freedom > 0:
            whole[some] = sweeper.misfit(pattern, block)
            ratio[some] = whole[some] / quantile(1.0 / poses, freedom)
            middle[some] = whole[some] / quantile(0.5, freedom)
    known = np.isfinite(middle)
    scale = float(np.median(middle[known])) if known.any() else 0.0
    scale = scale if task.exact else max(scale, 1.0)
    return whole, ratio / max(scale, 1e-300)


def _some(noise: Noise, index: NDArray[np.intp]) -> Noise:
    """The noise of some poses."""
    return _by_pose(noise, lambda key: noise.entries[key][index])


def _by_pose(noise: Noise, stated: Callable[[Any], Array]) -> Noise:
    """The noise with something else for what is stated pose by pose."""
    part = copy(noise)  # with its sources
    part.entries = {
        key: stated(key)
        if isinstance(value, np.ndarray) and value.ndim == (3 if isinstance(key, tuple) else 1)
        else value
        for key, value in noise.entries.items()
    }
    return part


def _together(parts: list[Chunk]) -> Chunk:
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
    noise = _by_pose(
        first.noise, lambda key: np.concatenate([part.noise.entries[key] for part in parts])
    )
    return Chunk(data, noise)
