"""Corners: pixels of named points, with the image, camera and board that each belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.lazy import cached_property
from loopcal.mechanisms.cameras.board import Board

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Views:
    """Each camera's view of one board in one image: which, and its first corner.

    image, camera, board, first: (V,); of_corner: (N,) the view of each corner.
    """

    image: Indices
    camera: Indices
    board: Indices
    first: Indices
    of_corner: Indices

    def __len__(self) -> int:
        return self.image.size

    @property
    def sizes(self) -> Indices:
        """(V,) corners of each view."""
        return np.diff(np.append(self.first, self.of_corner.size))

    def sums(self, values: Array) -> Array:
        """(V, ...) sums over the corners (N, ...) of each view."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def products(self, rows: Array) -> Array:
        """(V, m, m) sums of rows^T rows over the corners (N, d, m) of each view."""
        n, d, m = rows.shape
        blocks = np.zeros((len(self), int(self.sizes.max()), d, m))
        blocks[self.of_corner, np.arange(n) - self.first[self.of_corner]] = rows
        padded = blocks.reshape(len(self), -1, m)
        return np.asarray(np.swapaxes(padded, 1, 2) @ padded)

    def medians(self, values: Array, beyond: int = 0) -> Array:
        """(V,) upper medians over the corners (N,) of each view, without its `beyond` least."""
        ranked = values[np.lexsort((values, self.of_corner))]
        middle = np.minimum((self.sizes + beyond) // 2, self.sizes - 1)
        return np.asarray(ranked[self.first + middle])


@dataclass(frozen=True)
class Corners:
    """N pixels, sorted by image, camera and board when made by `of`.

    image, camera, board, point: (N,) indices into `poses`, `cameras`, `boards` and the points of
    that board; uv: (N, 2) [px].
    """

    image: Indices
    camera: Indices
    board: Indices
    point: Indices
    uv: Array
    cameras: tuple[str, ...]
    boards: tuple[Board, ...]
    poses: tuple[str, ...]

    @classmethod
    def of(
        cls,
        index: Sequence[Indices],
        uv: Array,
        cameras: Sequence[str],
        boards: Sequence[Board],
        poses: Sequence[str],
    ) -> Corners:
        """From the indices (image, camera, board, point) of each corner, in any order."""
        image, camera, board, point = (np.asarray(i, dtype=np.intp) for i in index)
        order = np.lexsort((point, board, camera, image))
        image, camera, board, point = (i[order] for i in (image, camera, board, point))
        pixels = np.asarray(uv, dtype=float)[order]
        names = tuple(cameras), tuple(boards), tuple(poses)
        return cls(image, camera, board, point, pixels, *names)

    def __len__(self) -> int:
        return self.image.size

    @cached_property
    def xyz(self) -> Array:
        """(N, 3) [m] each corner's point in the frame of its board."""
        sizes = [0, *(len(board.points) for board in self.boards)]
        every = np.concatenate([board.xyz for board in self.boards])
        return np.asarray(every[np.cumsum(sizes)[self.board] + self.point])

    @cached_property
    def views(self) -> Views:
        """The views, in the order of the corners."""
        key = np.stack([self.image, self.camera, self.board])
        new = np.append(True, np.any(np.diff(key, axis=1) != 0, axis=0))
        first = np.flatnonzero(new)
        image, camera, board = key[:, first]
        return Views(image, camera, board, first, np.cumsum(new) - 1)

    def where(self, keep: NDArray[np.bool_] | Indices) -> Corners:
        """Only the corners of a mask, or of indices that ascend."""
        return replace(
            self,
            image=self.image[keep],
            camera=self.camera[keep],
            board=self.board[keep],
            point=self.point[keep],
            uv=self.uv[keep],
        )

    def seen(self, *, image: int | None = None, camera: int | None = None) -> Corners:
        """Only the corners of one image, of one camera, or both."""
        keep = np.ones(len(self), dtype=bool)
        if image is not None:
            keep &= self.image == image
        if camera is not None:
            keep &= self.camera == camera
        return self.where(keep)

    def at(self, uv: Array) -> Corners:
        """The same corners at other pixels (N, 2)."""
        return replace(self, uv=uv)

    def numbered(self, point: Indices) -> Corners:
        """The same pixels as other points (N,) of their boards."""
        return replace(self, point=point)
