"""Rigid motions and their twists, many at once.

exp of a twist (t, w) is the motion with rotation exp([w]) and translation t: the first-order
update T <- (exp([w]), t) T of the iterations here, exact in its rotation.
"""

from __future__ import annotations

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rotations import nearest_rotation, rotation_by, skew


def moved(T: Array, twist: Array) -> Array:
    """exp(twist) T of twists (..., 6), translation first."""
    return np.asarray(rigid(rotation_by(twist[..., 3:]), twist[..., :3]) @ T)


def adjoint(T: Array) -> Array:
    """(..., 6, 6): the twist before T that equals a small one behind it, translation first."""
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = T[..., :3, :3]
    out[..., :3, 3:] = skew(T[..., :3, 3]) @ T[..., :3, :3]
    return out


def mean_motion(T: Array, weight: Array) -> Array:
    """(4, 4): the weighted chordal mean of (n, 4, 4)."""
    w = weight / weight.sum()
    return rigid(
        nearest_rotation(np.einsum("i,ijk->jk", w, T[:, :3, :3])),
        np.einsum("i,ij->j", w, T[:, :3, 3]),
    )
