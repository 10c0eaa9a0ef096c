"""Poses in chunks: what a stream brings, and some of its poses taken or joined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.learning import with_model
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some consecutive poses, and what is stated of their noise."""

    data: Dataset
    noise: Noise

    def take(self, index: NDArray[np.intp]) -> Chunk:
        """Some of the poses, in this order."""
        noise = _by_pose(self.noise, lambda key: self.noise.entries[key][index])
        return Chunk(self.data.take(index), noise)


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
    noise = _by_pose(
        first.noise, lambda key: np.concatenate([part.noise.entries[key] for part in parts])
    )
    return Chunk(data, noise)


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
class Derived:
    """A stream whose chunks are those of another, changed by `chunk`."""

    stream: Stream
    mechanism: Mechanism

    @property
    def poses(self) -> int:
        return self.stream.poses

    @property
    def count(self) -> int:
        return self.stream.count


@dataclass(frozen=True, eq=False)
class Disturbed(Derived):
    """A stream with the readings of the machine model's own error, where the noise names it."""

    def chunk(self, number: int) -> Chunk:
        chunk = self.stream.chunk(number)
        _, data = with_model(self.mechanism, chunk.data, chunk.noise)
        return Chunk(data, chunk.noise)
