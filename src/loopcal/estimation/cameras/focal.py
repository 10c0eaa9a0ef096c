"""A lens without stated intrinsics: its focal length, from tilted boards or fields of view."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.homography import focal_length, homographies, spread
from loopcal.estimation.cameras.placing import Reading, placed, view_poses
from loopcal.estimation.cameras.scene import Adjusted
from loopcal.mechanisms.cameras.lens import Intrinsics

Array = NDArray[np.float64]
FIELDS = (60.0, 35.0, 90.0, 20.0)
"""Horizontal fields of view [deg] to try: the adjustment converges from a factor of two in f."""
WIDE = (100.0, 140.0, 180.0)
"""The same for a fisheye."""


def guessed(
    corners: Corners, camera: int, size: tuple[int, int] | None, lens: str = "brown5"
) -> list[Intrinsics]:
    """Lenses to start from, the most plausible first: square pixels, no distortion.

    From homographies where three boards are tilted and the lens is no fisheye, then by fields of
    view. Of two that adjust alike the first stands.
    """
    mine = corners.seen(camera=camera)
    mine = replace(mine, camera=np.zeros_like(mine.camera), cameras=(corners.cameras[camera],))
    centre, width = frame(mine, size)
    lenses = [
        Intrinsics(lens, f, f, float(centre[0]), float(centre[1]), (), size)
        for f in _focal_lengths(mine, centre, width, lens)
    ]
    return sorted(lenses, key=lambda one: _misfit(mine, one))


def frame(corners: Corners, size: tuple[int, int] | None) -> tuple[Array, float]:
    """Middle (2,) and width [px] of an image; without its size, of what the corners cover."""
    if size is not None:
        return (np.array(size, dtype=float) - 1.0) / 2.0, float(size[0])
    low, high = corners.uv.min(axis=0), corners.uv.max(axis=0)
    return (low + high) / 2.0, float(max(high - low))


def _focal_lengths(corners: Corners, centre: Array, width: float, lens: str) -> Iterator[float]:
    if lens == "fisheye":
        yield from (width / np.radians(field) for field in WIDE)
        return
    flat = np.array([board.planar for board in corners.boards])[corners.board]
    if flat.any():
        some = Reading(corners.where(flat), None, ()).thinned(60, 40).corners
        xy, views = some.xyz[:, :2], some.views
        H, _ = homographies(views, xy, some.uv)
        f = focal_length(H[spread(views, xy)], centre)
        if f is not None and 0.2 * width < f < 20.0 * width:
            yield f
    yield from (0.5 * width / np.tan(np.radians(field / 2.0)) for field in FIELDS)


def _misfit(corners: Corners, lens: Intrinsics) -> float:
    """Core rms [px] with a free pose per image after f and k1 were adjusted."""
    reading = Reading(corners, None, (lens,)).thinned(20, 12)
    adjusted = placed(reading, view_poses(reading), ("f", "k1"), iterations=6)
    return np.inf if adjusted is None else core_of(adjusted)


def core_of(adjusted: Adjusted) -> float:
    """Core rms in steps of 2 %: lenses that differ by less are equally good."""
    return float(np.round(np.log(max(adjusted.core, 1e-6)) / 0.02))
