"""Rotations, many at once: matrices, their vectors and quaternions, and the nearest rotation."""

from __future__ import annotations

import numpy as np

from loopcal.arrays import Array


def skew(v: Array) -> Array:
    """(..., 3, 3): [v] with [v] u = v x u."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def rotation_by(w: Array) -> Array:
    """(..., 3, 3): exp([w]) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = skew(w)
    # sin(a)/a and (1 - cos a)/a^2, without a quotient of small numbers.
    a, half = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + a * K + 0.5 * half**2 * (K @ K))


def rotation_vector(R: Array) -> Array:
    """(..., 3) [rad]: w with exp([w]) = R (..., 3, 3) and |w| at most pi."""
    q = quaternions(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    return np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0) * q[..., 1:]


def quaternions(R: Array) -> Array:
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


def rotations(q: Array) -> Array:
    """(..., 3, 3): of quaternions (..., 4) of any length, w first: 1 + 2 w [v] + 2 [v]^2."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    K = skew(q[..., 1:])
    return np.asarray(np.eye(3) + 2.0 * q[..., :1, None] * K + 2.0 * (K @ K))


def nearest_rotation(M: Array) -> Array:
    """(..., d, d): the rotation R that maximises tr(R^T M), no mirror image (Umeyama 1991)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, -1] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)
