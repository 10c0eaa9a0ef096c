"""Many poses at once: logarithms, exponentials and ways of writing rigid motions, (N, 4, 4).

Turns are rotation vectors. A twist of two poses is (v, w), the shift of the origin and the turn,
both in the frame of the poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.placement import rigid

Array = NDArray[np.float64]


def turned(w: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = crossing(w)
    # Below, sin(a)/a and (1 - cos a)/a^2 equal 1 and 1/2 to rounding.
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    R: Array = np.eye(3) + first * K + second * (K @ K)
    return R


def crossing(w: Array) -> Array:
    """(..., 3, 3) the matrix of v -> w x v."""
    K = np.zeros((*w.shape, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = w[..., 0], w[..., 1], w[..., 2]
    made: Array = K - np.swapaxes(K, -1, -2)
    return made


def turn_of(R: Array) -> Array:
    """Rotation vectors (..., 3) of rotation matrices (..., 3, 3), of at most half a turn."""
    q = quaternion_of(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    w: Array = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0) * q[..., 1:]
    return w


def quaternion_of(R: Array) -> Array:
    """Unit quaternions (..., 4), w first and not negative, of rotation matrices (..., 3, 3).

    The largest of four ways to begin is taken (Shepperd 1978).
    """
    t = np.einsum("...ii->...i", R)
    trace = t.sum(axis=-1)
    squares = np.stack([trace, *np.moveaxis(2.0 * t - trace[..., None], -1, 0)], axis=-1)
    M = np.empty((*trace.shape, 4, 4))  # 4 q_i q_j
    for i in range(4):
        M[..., i, i] = 1.0 + squares[..., i]
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        M[..., 0, i + 1] = M[..., i + 1, 0] = R[..., k, j] - R[..., j, k]
        M[..., j + 1, k + 1] = M[..., k + 1, j + 1] = R[..., j, k] + R[..., k, j]
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(M, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    signed: Array = np.where(q[..., :1] < 0.0, -q, q)
    return signed


def between(T: Array, target: Array) -> Array:
    """(..., 6) the twist that leads from poses T to the target: shift and turn."""
    turn = turn_of(target[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2))
    return np.concatenate([target[..., :3, 3] - T[..., :3, 3], turn], axis=-1)


def moved(T: Array, twist: Array, share: float) -> Array:
    """The poses a share of a twist onwards: the origin straight, the turn about one axis."""
    R = turned(share * twist[..., 3:]) @ T[..., :3, :3]
    return rigid(R, T[..., :3, 3] + share * twist[..., :3])
