"""Rigid motions and their twists, many at once.

exp of a twist (t, w) is the motion with rotation exp([w]) and translation t: the first-order
update T <- (exp([w]), t) T of the iterations here, exact in its rotation.
"""

from __future__ import annotations

import numpy as np

from loopcal.arrays import Array


def skew(v: Array) -> Array:
    """(..., 3, 3): [v] with [v] u = v x u."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def rotation(w: Array) -> Array:
    """(..., 3, 3): exp([w]), Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = skew(w)
    a, half = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + a * K + 0.5 * half**2 * (K @ K))


def rotation_vector(R: Array) -> Array:
    """(..., 3) [rad]: w with exp([w]) = R and |w| at most pi."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()).reshape(R.shape[:-1])


def rigid(R: Array, t: Array) -> Array:
    """(..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def moved(T: Array, twist: Array) -> Array:
    """exp(twist) T of twists (..., 6), translation first."""
    return np.asarray(rigid(rotation(twist[..., 3:]), twist[..., :3]) @ T)


def inverse(T: Array) -> Array:
    """T^-1 of rigid motions (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return rigid(Rt, -(Rt @ T[..., :3, 3, None])[..., 0])


def adjoint(T: Array) -> Array:
    """(..., 6, 6): the twist before T that equals a small one behind it, translation first."""
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = T[..., :3, :3]
    out[..., :3, 3:] = skew(T[..., :3, 3]) @ T[..., :3, :3]
    return out


def nearest_rotation(M: Array) -> Array:
    """(..., 3, 3): the rotation R that maximises tr(R^T M)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


def mean_motion(T: Array, weight: Array) -> Array:
    """(4, 4): the weighted chordal mean of (n, 4, 4)."""
    w = weight / weight.sum()
    return rigid(
        nearest_rotation(np.einsum("i,ijk->jk", w, T[:, :3, :3])),
        np.einsum("i,ij->j", w, T[:, :3, 3]),
    )
