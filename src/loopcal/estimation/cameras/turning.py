"""What the turns of a hand mean, by how far the board turns from image to image.

    C_i = X A_i Y    turns by the same angle as A_i from one image to another,

wherever camera and board stand, so no placement is needed to compare.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.cameras.placing import Reading, view_poses

Array = NDArray[np.float64]
_VIEWS = 60


def most_alike(ways: Mapping[str, Array], reading: Reading) -> tuple[str, float]:
    """Which of the poses (n, 4, 4) turn as the board does, by their names, and the median
    difference [rad]; of views that allow two poses of the board the nearer counts."""
    few = reading.thinned(_VIEWS, 24)
    poses, views = view_poses(few), few.corners.views
    usable = np.flatnonzero(poses.usable)
    one, other = np.array([(i, j) for i in usable for j in usable if i < j]).reshape(-1, 2).T
    same = (views.camera[one] == views.camera[other]) & (views.board[one] == views.board[other])
    one, other = one[same], other[same]
    R = poses.T_camera_board[:, :, :3, :3]
    seen = [_angles(R[one, a], R[other, b]) for a in (0, 1) for b in (0, 1)]
    sizes = {}
    for name, T in ways.items():
        hand = T[views.image, :3, :3]
        away = np.abs(np.array(seen) - _angles(hand[one], hand[other])).min(axis=0, initial=np.inf)
        sizes[name] = float(np.median(away)) if away.size else 0.0
    best = min(sizes, key=lambda name: sizes[name])
    return best, sizes[best]


def _angles(R: Array, S: Array) -> Array:
    """(n,) [rad] between rotations."""
    cosine = (np.einsum("nij,nij->n", R, S) - 1.0) / 2.0
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=1.0), -1.0, 1.0)))
