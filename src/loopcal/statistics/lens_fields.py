"""What a lens leaves in two calibrations is one field, and cancels where both saw the same of it.

The field of a camera, of amplitudes b ~ N(0, S), moves the estimates of calibration i by M_i b
(`estimation.dependence.lens_errors`). Each covariance has M_i S M_i^T. The difference of two has

    (M_1 - M_2) S (M_1 - M_2)^T,

not the sum of both. S is the larger one of both. Waves over an image of another size are sums of
those over the first, F_1 = K^T F_2 by least squares, so that b_2 = K b_1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import LensErrorEntry

# Chosen, not derived: as lenses and waves are compared, five points in the shortest half wave.
_GRID = 25
"""Points of a side of the image at which waves of two sizes are compared."""
_PLACES = (np.arange(_GRID) + 0.5) / _GRID


@dataclass(frozen=True, eq=False)
class LensField:
    """image: the size [px]; spectrum: (w,) diagonal of S; moved: M (n, w) of n parameters [SI]."""

    camera: str
    image: tuple[float, float]
    spectrum: Array
    moved: Array

    @property
    def covariance(self) -> Array:
        """(n, n) what that of the parameters contains."""
        return np.asarray((self.moved * self.spectrum) @ self.moved.T)

    def through(self, M: Array) -> LensField:
        """Of M (m, n) times the parameters."""
        return replace(self, moved=M @ self.moved)

    def over(self, image: tuple[float, float]) -> Array:
        """(n, w) how the waves over an image of this size move the parameters."""
        if image == self.image:
            return self.moved
        from loopcal.estimation.dependence.lens_errors import waves  # of cameras alone

        size = np.minimum(image, self.image)
        u, v = (side.ravel() for side in np.meshgrid(*np.outer(size, _PLACES)))
        mine, other = (waves(u / one[0], v / one[1]).T for one in (self.image, image))
        K = np.linalg.lstsq(mine, other, rcond=None)[0]
        return np.asarray(self.moved @ np.kron(np.eye(2), K))


def lens_fields(entries: Sequence[LensErrorEntry], place: Array) -> tuple[LensField, ...]:
    """Of the parameters place (n, k) times the estimated ones; none of an earlier version."""
    return tuple(
        LensField(one.camera, one.image, np.array(one.spectrum), place @ np.array(one.moved))
        for one in entries
        if one.moved
    )


def apart(
    first: Sequence[LensField], second: Sequence[LensField], size: int, learnt: Sequence[LensField]
) -> Array:
    """(n, n) what the covariance of the difference of n parameters contains; learnt: whose S
    counts, the largest of each camera."""
    total = np.zeros((size, size))
    for camera in dict.fromkeys(one.camera for one in (*first, *second)):
        most = max(
            (one for one in learnt if one.camera == camera), key=lambda one: one.spectrum.sum()
        )
        moved = np.zeros((size, len(most.spectrum)))
        for sign, fields in ((1.0, first), (-1.0, second)):
            for one in fields:
                if one.camera == camera:
                    moved += sign * one.over(most.image)
        total += (moved * most.spectrum) @ moved.T
    return total
