"""Vectors and rotations for loop functions, so that robot code reads like robot code.

Vectors are arrays of 3, rotations 3x3 matrices, `@` multiplies them; all of it works alike on
traced values, plain numbers and arrays of poses. `rotate` turns a vector about a coordinate axis
without building the matrix: the cheapest way to write a chain, from its tip to its base.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.expressions.trace import Scalar

PLANES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}
"""The two axes that a turn about a coordinate axis moves: the first towards the second."""


def vector(x: Any, y: Any, z: Any) -> NDArray[Any]:
    """The vector (x, y, z)."""
    if any(isinstance(v, Scalar) for v in (x, y, z)):
        out = np.empty(3, dtype=object)
        out[:] = [x, y, z]
        return out
    return np.array(np.broadcast_arrays(x, y, z), dtype=float)


def rotate(axis: str, angle: Any, v: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    """The vector v turned by the angle [rad] about the coordinate axis "x", "y" or "z".

    rotate("z", a, v) = rot_z(a) @ v.
    """
    if axis not in PLANES:
        raise InputError(
            f"axis {axis!r} is not a coordinate axis",
            code="invalid-value",
            remedy="give 'x', 'y' or 'z'",
        )
    i, j = PLANES[axis]
    parts: list[Any] = list(v)
    parts[i], parts[j] = _turned(parts[i], parts[j], angle)
    return vector(*parts)


def _turned(a: Any, b: Any, angle: Any) -> tuple[Any, Any]:
    traced = next((s for s in (a, b, angle) if isinstance(s, Scalar)), None)
    if traced is None:
        cosine, sine = np.cos(angle), np.sin(angle)
        return a * cosine - b * sine, a * sine + b * cosine
    return traced.turned("turn_cos", a, b, angle), traced.turned("turn_sin", a, b, angle)


def _matrix(axis: str, angle: Any) -> NDArray[Any]:
    columns = [rotate(axis, angle, unit) for unit in np.eye(3)]
    return np.stack(columns, axis=1)


def rot_x(angle: Any) -> NDArray[Any]:
    """The matrix that turns vectors by the angle [rad] about the x axis, right-handed."""
    return _matrix("x", angle)


def rot_y(angle: Any) -> NDArray[Any]:
    """The matrix that turns vectors by the angle [rad] about the y axis, right-handed."""
    return _matrix("y", angle)


def rot_z(angle: Any) -> NDArray[Any]:
    """The matrix that turns vectors by the angle [rad] about the z axis, right-handed."""
    return _matrix("z", angle)


def dot(a: Sequence[Any] | NDArray[Any], b: Sequence[Any] | NDArray[Any]) -> Any:
    """The scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Sequence[Any] | NDArray[Any], b: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    """The vector product of two vectors."""
    return vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(v: Sequence[Any] | NDArray[Any]) -> Any:
    """The length of a vector; its derivative does not exist at length zero."""
    return np.sqrt(np.square(v[0]) + np.square(v[1]) + np.square(v[2]))
