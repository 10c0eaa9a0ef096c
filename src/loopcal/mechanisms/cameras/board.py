"""What a camera sees: points on a board, by their ids, in the board's frame.

The board's frame has x and y along the print and z out of it [m]; for markers on a body it is any
frame of that body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError


@dataclass(frozen=True)
class Pattern:
    """How a board is printed, for those who look for it in an image.

    kind: one of `printed.KINDS`; columns, rows: of inner corners, circles, tags, or squares of a
    ChArUco board; marker: its side over that of a square, or a tag's over the step from tag to
    tag; dictionary: of markers, as in OpenCV; legacy: ChArUco as OpenCV printed it before 4.6.
    """

    kind: str
    columns: int
    rows: int
    marker: float = 0.0
    dictionary: str = ""
    legacy: bool = False


@dataclass(frozen=True)
class Board:
    """Named points (x, y, z) [m] of one rigid thing; pattern: None where nobody stated it.

    Raises InputError for one without points.
    """

    name: str
    points: Mapping[str, tuple[float, float, float]]
    pattern: Pattern | None = None

    def __post_init__(self) -> None:
        if not self.points:
            raise InputError(
                f"the board {self.name!r} has no points",
                code="no-data",
                remedy="state its points, or its kind and size",
            )

    @property
    def xyz(self) -> NDArray[np.float64]:
        """(n, 3) [m] in the order of the ids."""
        return np.array(list(self.points.values()), dtype=float)

    @property
    def planar(self) -> bool:
        """Whether all its points have the same z."""
        return bool(np.ptp(self.xyz[:, 2]) == 0.0)

    @property
    def half(self) -> tuple[float, float]:
        """Half its width and height [m], about the middle of its points."""
        x, y = (np.ptp(self.xyz[:, i]) / 2.0 for i in (0, 1))
        return float(x), float(y)

    @property
    def middle(self) -> tuple[float, float, float]:
        """The middle between its extreme points [m]."""
        low, high = self.xyz.min(axis=0), self.xyz.max(axis=0)
        x, y, z = ((low + high) / 2.0).tolist()
        return x, y, z
