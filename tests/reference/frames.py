"""Serial arms written out as 4x4 matrices, one pose at a time, as textbooks do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def turn(axis: str, angle: float) -> Matrix:
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    T[:3, :3] = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return T


def move(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Matrix:
    """Translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def motion(name: str, amount: float) -> Matrix:
    """An elementary motion by its name: tx, ty, tz, rx, ry, rz."""
    return move(**{name[1]: amount}) if name[0] == "t" else turn(name[1], amount)


def dh(a: float, d: float, alpha: float, theta: float) -> Matrix:
    """Denavit and Hartenberg: Rz(theta) Tz(d) Tx(a) Rx(alpha), as printed in textbooks."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def modified_dh(a: float, d: float, alpha: float, theta: float) -> Matrix:
    """Craig's form: Rx(alpha) Tx(a) Rz(theta) Tz(d), as printed in textbooks."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def hayati(a: float, alpha: float, beta: float, theta: float) -> Matrix:
    """Hayati's form for parallel axes: Rz(theta) Tx(a) Rx(alpha) Ry(beta)."""
    return turn("z", theta) @ move(x=a) @ turn("x", alpha) @ turn("y", beta)


def transition(axis: str, numbers: Sequence[float], joint: Matrix) -> Matrix:
    """The seed's four parameters: two shifts, two turns in the plane normal to the joint axis."""
    first, second = {"z": ("x", "y"), "y": ("x", "z"), "x": ("y", "z")}[axis]
    a, b, phi_a, phi_b = numbers
    return move(**{first: a, second: b}) @ turn(first, phi_a) @ turn(second, phi_b) @ joint


def fixed_motions(motions: Mapping[str, float]) -> Matrix:
    """Fixed motions in the order of writing."""
    T = np.eye(4)
    for name, amount in motions.items():
        T = T @ motion(name, amount)
    return T


def point_of(T: Matrix, tool: Any) -> NDArray[np.float64]:
    """The tool point in the first frame."""
    reached: NDArray[np.float64] = (T @ np.append(tool, 1.0))[:3]
    return reached
