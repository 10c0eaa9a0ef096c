"""Poses in chunks: what a stream brings, and some of its poses taken or joined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise

Array = NDArray[np.float64]


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
