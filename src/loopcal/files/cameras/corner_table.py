"""Corners that cameras have seen in images, column by column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array


@dataclass(frozen=True, eq=False)
class CornerTable:
    """Corners, a row each: names of image, camera, board and point, and pixel u, v.

    u, v: (N,) [px], (0, 0) the centre of the first pixel; sd: (N,) [px] of u and of v, NaN or None
    where none is stated; level: (N,) of the reduced image in which mrcal saw a corner, None
    where none is stated; file: where they come from; sizes: camera -> width and height of its
    images, where they were read.
    """

    image: tuple[str, ...]
    camera: tuple[str, ...]
    board: tuple[str, ...]
    point: tuple[str, ...]
    u: Array
    v: Array
    sd: Array | None = None
    level: Array | None = None
    file: str = ""
    sizes: tuple[tuple[str, tuple[int, int]], ...] = ()

    def __len__(self) -> int:
        return len(self.image)

    @property
    def images(self) -> tuple[str, ...]:
        """Each image once, in the order of the rows."""
        return tuple(dict.fromkeys(self.image))

    @property
    def cameras(self) -> tuple[str, ...]:
        """Each camera once, in the order of the rows."""
        return tuple(dict.fromkeys(self.camera))

    @property
    def boards(self) -> tuple[str, ...]:
        """Each board once, in the order of the rows."""
        return tuple(dict.fromkeys(self.board))

    def at(self, rows: Sequence[int] | NDArray[np.intp]) -> CornerTable:
        """These rows alone."""

        def some(names: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(names[i] for i in rows)

        index = np.asarray(rows, dtype=np.intp)
        return replace(
            self,
            image=some(self.image),
            camera=some(self.camera),
            board=some(self.board),
            point=some(self.point),
            u=self.u[index],
            v=self.v[index],
            sd=None if self.sd is None else self.sd[index],
            level=None if self.level is None else self.level[index],
        )
