"""From pixels to rays and back, with derivatives, for any lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.cameras.lens import Intrinsics, project

_ITERATIONS = 12
_STEP = 1e-6
"""Central differences of smooth functions of order 1: errors of 1e-12 and of 1e-10 by rounding."""
_STEPS = _STEP * np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])
_AT_ONCE = 500


def pixels(lens: str, P: Array, values: Mapping[str, float]) -> Array:
    """(N, 2) [px] of points (N, 3) in the camera's frame."""
    return np.stack(project(lens, (P[:, 0], P[:, 1], P[:, 2]), values), axis=1)


def by_point(lens: str, P: Array, values: Mapping[str, float]) -> Array:
    """(N, 2, 3) [px/m]: derivatives by the point; a pixel depends on P/Z alone."""
    x = P[:, :2] / P[:, 2:]
    out = np.empty((len(P), 2, 3))
    for part in _parts(len(P)):
        X, Y = x[part].T[:, None] + _STEPS[:, :, None]
        uv = np.array(project(lens, (X, Y, np.ones(X.shape[1])), values))
        out[part, :, :2] = (uv[:, ::2] - uv[:, 1::2]).transpose(2, 0, 1)
    out[:, :, :2] = out[:, :, :2] / (2.0 * _STEP) / P[:, 2:, None]
    out[:, :, 2] = -(out[:, :, 0] * x[:, :1] + out[:, :, 1] * x[:, 1:])
    return out


def by_value(lens: str, P: Array, values: Mapping[str, float], names: Sequence[str]) -> Array:
    """(N, 2, k): derivatives by the named values of a lens."""
    out = np.empty((len(P), 2, len(names)))
    steps = np.array([_STEP * max(1.0, abs(values[name])) for name in names])
    shifted: dict[str, Any] = dict(values)
    for j, name in enumerate(names):
        shifted[name] = np.full((2 * len(names), 1), values[name])
        shifted[name][2 * j : 2 * j + 2, 0] += steps[j], -steps[j]
    for part in _parts(len(P)):
        uv = project(lens, P[part].T, shifted)
        u, v = (np.broadcast_to(one, (2 * len(names), len(P[part]))) for one in uv)
        out[part, 0] = ((u[::2] - u[1::2]) / (2.0 * steps[:, None])).T
        out[part, 1] = ((v[::2] - v[1::2]) / (2.0 * steps[:, None])).T
    return out


def _parts(count: int) -> list[slice]:
    """Some points after others, so few that all differences of them stay in the cache."""
    return [slice(i, i + _AT_ONCE) for i in range(0, count, _AT_ONCE)]


def rays(intrinsics: Intrinsics, uv: Array) -> Array:
    """(N, 2): X/Z and Y/Z whose pixels are uv, by Newton's method.

    Where the lens turns back before a pixel, the last iterate stands: a corner there is an
    outlier for all that follows.
    """
    values = intrinsics.values
    centre = np.array([intrinsics.cx, intrinsics.cy])
    x = (uv - centre) / np.array([intrinsics.fx, intrinsics.fy])
    if intrinsics.lens == "pinhole":
        return np.asarray(x)
    if intrinsics.lens == "fisheye":
        # Without distortion the distance from the centre is the angle itself.
        angle = np.linalg.norm(x, axis=1, keepdims=True)
        x = x * np.tan(np.minimum(angle, 1.4)) / np.maximum(angle, 1e-12)
    most = 2.0 * np.abs(x).max(initial=1.0)
    for _ in range(_ITERATIONS):
        P = np.column_stack([x, np.ones(len(x))])
        J = by_point(intrinsics.lens, P, values)[:, :, :2]
        J = J + 1e-12 * intrinsics.fx * np.eye(2)
        step = np.linalg.solve(J, (uv - pixels(intrinsics.lens, P, values))[:, :, None])[:, :, 0]
        x = np.clip(x + step, -most, most)
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    return np.asarray(x)
