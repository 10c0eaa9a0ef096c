"""The machine as a body: a capsule about each line of its skeleton, as triangles of one mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.figures.figure import numbers

SIDES = 12
"""Corners of a ring. The rounding is seen, and a scene of software stays quick."""
THICK = 0.03
"""Radius over the length of the longest limb: as slender as an arm, and links stay apart."""
COLOUR = "#9db0b8"
# Latitudes of the rings of the two half spheres; between the middle two lies the cylinder.
_LATITUDES = np.radians([-90.0, -45.0, 0.0, 0.0, 45.0, 90.0])


def capsules(points: Array) -> dict[str, Any]:
    """The trace for a skeleton (k, 3) [m], whose lines are parted by rows of NaN.

    Its triangles depend on k alone, so that a machine that moves keeps them: a line of no length,
    or none at all, has a capsule of no size.
    """
    return body(vertices(points), _triangles(len(points) - 1))


def body(corners: Array, faces: NDArray[np.intp]) -> dict[str, Any]:
    """The trace of a body with these corners (n, 3) [m] and triangles (m, 3)."""
    i, j, k = faces.T.tolist()
    return {
        **{"type": "mesh3d", "color": COLOUR, "hoverinfo": "skip", "flatshading": False},
        **dict(zip("xyz", map(numbers, corners.T), strict=True)),
        **{"i": i, "j": j, "k": k},
        "lighting": {"ambient": 0.55, "diffuse": 0.7, "specular": 0.1},
    }


def vertices(points: Array) -> Array:
    """(n, 3) the corners [m] of its capsules, line by line and ring by ring."""
    begin, end = points[:-1], points[1:]
    lengths = np.nan_to_num(np.linalg.norm(end - begin, axis=1))
    radius = THICK * _longest(lengths, np.isfinite(points).all(axis=1))
    extended = lengths > 1e-9
    axis = np.zeros_like(begin)
    axis[extended] = (end - begin)[extended] / lengths[extended, None]
    axis[~extended, 2] = 1.0
    # Across the axis: from the coordinate along which it extends least.
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    u = np.cross(axis, least)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axis, u)
    angle = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    around = np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]
    first = np.nanmean(points, axis=0)
    size = radius * extended
    rings = []
    for ring, latitude in enumerate(_LATITUDES):
        middle = np.where(extended[:, None], begin if ring < len(_LATITUDES) // 2 else end, first)
        middle = middle + (size * np.sin(latitude))[:, None] * axis
        rings.append(middle[:, None] + (size * np.cos(latitude))[:, None, None] * around)
    return np.stack(rings, axis=1).reshape(-1, 3)


def _longest(lengths: Array, finite: Any) -> float:
    """Of the runs of lines between rows of NaN."""
    limb = np.cumsum(~finite)[:-1]
    return float(np.bincount(limb, lengths).max(initial=0.0))


def _triangles(lines: int) -> NDArray[np.intp]:
    """(m, 3) positions of corners: two triangles between each two neighbours of two rings."""
    corner = np.arange(SIDES)
    after = (corner + 1) % SIDES
    band = np.vstack(
        [
            np.column_stack([corner, after, after + SIDES]),
            np.column_stack([corner, after + SIDES, corner + SIDES]),
        ]
    )
    count = len(_LATITUDES)
    steps = (np.arange(lines)[:, None] * count + np.arange(count - 1)).ravel() * SIDES
    return (band[None] + steps[:, None, None]).reshape(-1, 3)
