"""The MA1400 arm as a roboticist writes it in NumPy by hand: all poses at once, rotation matrices,
and the geometric Jacobian (a column is the axis itself, or axis x lever).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from chain import Chain, Factor
from numpy.typing import NDArray

Array = NDArray[np.float64]
AXES = "zyyxyz"
"""The axis that each joint turns about, in its own frame."""
DIRECTIONS = (1, 1, -1, -1, -1, -1)
PLANES = {"z": "xy", "y": "xz", "x": "yz"}
"""The plane in which each joint's four parameters move and turn."""


@dataclass(frozen=True)
class Frames:
    """Where the joints stand in N poses.

    origins: (N, 3) of each joint; before, between, after: its frame (N, 3, 3) ahead of its two
    fixed turns, between them and after them; last: the last frame; point: (N, 3) reached.
    """

    origins: list[Array]
    before: list[Array]
    between: list[Array]
    after: list[Array]
    last: Array
    point: Array


def rotations(axis: str, angles: Array) -> Array:
    """The matrices (N, 3, 3) that turn about a coordinate axis by angles (N,)."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.zeros((angles.size, 3, 3))
    k = 3 - i - j
    R[:, k, k] = 1.0
    R[:, i, i] = R[:, j, j] = np.cos(angles)
    R[:, j, i] = np.sin(angles)
    R[:, i, j] = -R[:, j, i]
    return R


def frames(joints: Array, p: Array) -> Frames:
    """All frames of the chain for joints (6, N) and parameters (27,)."""
    N = joints.shape[1]
    R, o = np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3))
    origins, before, between, after = [], [], [], []
    for k, axis in enumerate(AXES):
        a, b = tuple(PLANES[axis])
        shift = np.zeros(3)
        shift["xyz".index(a)], shift["xyz".index(b)] = p[4 * k], p[4 * k + 1]
        o = o + R @ shift
        origins.append(o)
        before.append(R)
        R = R @ rotations(a, p[4 * k + 2 : 4 * k + 3])
        between.append(R)
        R = R @ rotations(b, p[4 * k + 3 : 4 * k + 4])
        after.append(R)
        R = R @ rotations(axis, DIRECTIONS[k] * joints[k])
    return Frames(origins, before, between, after, R, o + R @ p[24:])


def point(joints: Array, p: Array) -> Array:
    """The point reached, (3, N)."""
    return frames(joints, p).point.T


def by_joint(joints: Array, p: Array) -> Array:
    """Derivatives by the joints, (3, 6, N)."""
    f = frames(joints, p)
    columns = [
        DIRECTIONS[k] * np.cross(f.after[k][:, :, "xyz".index(axis)], f.point - f.origins[k])
        for k, axis in enumerate(AXES)
    ]
    return np.stack(columns).transpose(2, 0, 1)


def by_parameter(joints: Array, p: Array) -> Array:
    """Derivatives by the parameters, (3, 27, N)."""
    f = frames(joints, p)
    columns = []
    for k, axis in enumerate(AXES):
        a, b = ("xyz".index(letter) for letter in PLANES[axis])
        lever = f.point - f.origins[k]
        columns += [f.before[k][:, :, a], f.before[k][:, :, b]]
        columns += [np.cross(f.before[k][:, :, a], lever), np.cross(f.between[k][:, :, b], lever)]
    columns += [f.last[:, :, i] for i in range(3)]
    return np.stack(columns).transpose(2, 0, 1)


def chain() -> Chain:
    """The same arm as a product: Tx Ty Rx Ry Rz(theta_1), Tx Tz Rx Rz Ry(theta_2), ..."""
    factors: list[Factor] = []
    for k, axis in enumerate(AXES):
        plane = ["xyz".index(letter) for letter in PLANES[axis]]
        four = [(kind, a) for kind in "tr" for a in plane]
        factors += [Factor(kind, a, 4 * k + i) for i, (kind, a) in enumerate(four)]
        factors.append(Factor("r", "xyz".index(axis), None, k, DIRECTIONS[k]))
    return Chain(tuple(factors), tip=(24, 25, 26))
