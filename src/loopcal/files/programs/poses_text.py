"""Poses as programs write them: millimetres and quaternions, or three turns in degrees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.mechanisms.placement import rigid, yaw_pitch_roll

Array = NDArray[np.float64]


def pose_of_turns(numbers: Sequence[float]) -> Array:
    """(4, 4) of x, y, z [mm] and rz, ry, rx [deg]: Tx Ty Tz Rz Ry Rx; NaN of infinite numbers."""
    if not all(map(math.isfinite, numbers)):
        return np.full((4, 4), np.nan)
    rz, ry, rx = map(math.radians, numbers[3:6])
    cz, sz, cy, sy, cx, sx = (f(a) for a in (rz, ry, rx) for f in (math.cos, math.sin))
    z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    return rigid(z @ y @ x, 1e-3 * np.array(numbers[:3]))


def turns_of_pose(T: Array) -> list[float]:
    """x, y, z [mm] and rz, ry, rx [deg] of a pose."""
    return [*(1e3 * T[:3, 3]).tolist(), *map(math.degrees, yaw_pitch_roll(T[:3, :3]))]


def pose_of_quaternion(numbers: Sequence[float], place: str) -> Array:
    """(4, 4) of x, y, z [mm] and w, x, y, z of a quaternion, which is normalised.

    Raises InputError for numbers whose squares do not sum to nearly 1.
    """
    q = np.array(numbers[3:7], dtype=float)
    length = float(np.linalg.norm(q))
    # Components with two decimals change the length by at most 0.005 * sqrt(4) = 0.01.
    if not 0.99 < length < 1.01:
        raise InputError(
            f"the quaternion has the length {length:.3f}",
            code="invalid-number",
            place=place,
            remedy="write a unit quaternion, w first",
        )
    w, x, y, z = q / length
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rigid(R, 1e-3 * np.array(numbers[:3]))


def quaternion_of_pose(T: Array, like: Sequence[float]) -> list[float]:
    """x, y, z [mm] and the quaternion, w first, of the sign that `like` has."""
    R = T[:3, :3]
    t = np.diag(R)
    # Shepperd (1978): 4 q_i^2 from the diagonal. Dividing by the largest component avoids
    # cancellation, which a fixed one meets near half a turn.
    squares = 1.0 + np.array([t.sum(), *(2.0 * t - t.sum())])
    i = int(np.argmax(squares))
    off = {(2, 1): R[2, 1] - R[1, 2], (0, 2): R[0, 2] - R[2, 0], (1, 0): R[1, 0] - R[0, 1]}
    turns = [off[2, 1], off[0, 2], off[1, 0]]
    rows = [[squares[0], *turns]]
    for k in range(3):
        rows.append([turns[k], *(R[k, m] + R[m, k] for m in range(3))])
        rows[-1][k + 1] = squares[k + 1]
    q = np.array(rows[i]) / np.linalg.norm(rows[i])
    if float(q @ np.array(like[3:7])) < 0.0:
        q = -q
    return [*(1e3 * T[:3, 3]).tolist(), *q.tolist()]
