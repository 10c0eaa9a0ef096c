"""An arm as a product of elementary transforms, and one pose of it in plain Python.

The point is T_1 T_2 ... T_s [tip; 1], each factor a move along or a turn about a coordinate axis.
A pose alone is too small for NumPy: a call of it costs more than the few products of a factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

Vector = tuple[float, float, float]
NONE: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Factor:
    """A move "t" or a turn "r" on the axis 0, 1 or 2: by a parameter, or by sign times a joint."""

    kind: str
    axis: int
    parameter: int | None
    joint: int = -1
    sign: int = 1


@dataclass(frozen=True)
class Chain:
    """The factors, and the parameters that are x, y, ... of the point in the last frame."""

    factors: tuple[Factor, ...]
    tip: tuple[int, ...]


@dataclass(frozen=True)
class Pose:
    """The point of one pose, and a column for each of its derivatives."""

    point: Vector
    by_joint: list[Vector]
    by_parameter: list[Vector]


def one_pose(chain: Chain, joints: Sequence[float], p: Sequence[float]) -> Pose:
    """One pose for joints (J,) and parameters (n,): a turn moves the point by axis x lever."""
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    x = y = z = 0.0
    passed = []
    for factor in chain.factors:
        k, i = factor.axis, factor.parameter
        a = axes[k]
        amount = factor.sign * joints[factor.joint] if i is None else p[i]
        passed.append((factor, a, x, y, z))
        if factor.kind == "t":
            x, y, z = x + amount * a[0], y + amount * a[1], z + amount * a[2]
        else:
            u, v = axes[k - 2], axes[k - 1]
            c, s = cos(amount), sin(amount)
            axes[k - 2] = (c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2])
            axes[k - 1] = (c * v[0] - s * u[0], c * v[1] - s * u[1], c * v[2] - s * u[2])
    by_joint, by_parameter = [NONE] * len(joints), [NONE] * len(p)
    for i, a in zip(chain.tip, axes, strict=False):
        by_parameter[i] = a
        x, y, z = x + p[i] * a[0], y + p[i] * a[1], z + p[i] * a[2]
    for factor, a, ox, oy, oz in passed:
        if factor.kind == "r":
            lx, ly, lz = x - ox, y - oy, z - oz
            a = (a[1] * lz - a[2] * ly, a[2] * lx - a[0] * lz, a[0] * ly - a[1] * lx)
        if factor.parameter is not None:
            by_parameter[factor.parameter] = a
        else:
            by_joint[factor.joint] = (factor.sign * a[0], factor.sign * a[1], factor.sign * a[2])
    return Pose((x, y, z), by_joint, by_parameter)
