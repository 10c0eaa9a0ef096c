"""Where a moving body stands: what is fixed to it, seen in the base frame of its machine.

Everything is written with vectors of three; a machine that moves in a plane keeps z at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, listed, unknown_name
from loopcal.expressions.vectors import dot, rotate, vector
from loopcal.mechanisms.chain import Step, apply
from loopcal.mechanisms.parameters import Parameter

Vector = NDArray[Any]
Values = Mapping[str, Any]
"""Readings or parameters by name: plain numbers, arrays of poses or traced values."""


class Frame(Protocol):
    """T_base_body of one pose, as what it does to points and directions of the body."""

    def point(self, p: Vector) -> Vector:
        """Coordinates (3,) [m] in the base frame of the body's point p."""

    def direction(self, v: Vector) -> Vector:
        """Components (3,) in the base frame of the body's direction v."""


@dataclass(frozen=True)
class ChainFrame:
    """The last frame of a chain of steps: T_base_body = S_1 S_2 ... S_n."""

    steps: Sequence[Step]
    joints: Values
    parameters: Values

    def point(self, p: Vector) -> Vector:
        """S_1 ... S_n p, from the tip to the base."""
        return apply(self.steps, p, self.joints, self.parameters)

    def direction(self, v: Vector) -> Vector:
        """The turns of the chain alone."""
        for step in reversed(self.steps):
            if step.motion[0] == "r":
                v = rotate(step.motion[1], step.amount(self.joints, self.parameters), v)
        return v


@dataclass(frozen=True)
class Relative:
    """A body as another one sees it: T_against_on = T_base_against^-1 T_base_on."""

    on: Frame
    against: Frame

    def point(self, p: Vector) -> Vector:
        """R_against^T (p_on - o_against)."""
        at = self.against.point(vector(0.0, 0.0, 0.0))
        return self._turned(self.on.point(p) - at)

    def direction(self, v: Vector) -> Vector:
        """R_against^T v_on."""
        return self._turned(self.on.direction(v))

    def _turned(self, v: Vector) -> Vector:
        axes = (self.against.direction(vector(*axis)) for axis in np.eye(3))
        return vector(*(dot(axis, v) for axis in axes))


@dataclass(frozen=True)
class BodyFrame:
    """A body by its rotation matrix R (3, 3) and origin o (3,): p_base = R p + o.

    Of arrays of N poses (3, 3, N) and (3, N).
    """

    rotation: NDArray[Any]
    origin: Vector

    def point(self, p: Vector) -> Vector:
        """R p + o."""
        return self.direction(p) + self.origin

    def direction(self, v: Vector) -> Vector:
        """R v."""
        turned: Vector = sum(self.rotation[:, k] * v[k] for k in range(3))
        return turned


def matrices(frame: Frame, count: int) -> NDArray[np.float64]:
    """(N, 4, 4) T_base_body of a frame whose joints are readings (N,) of `count` poses."""
    T = np.zeros((count, 4, 4))
    for i, axis in enumerate(np.eye(3)):
        for k, part in enumerate(frame.direction(vector(*axis))):
            T[:, k, i] = part
    for k, part in enumerate(frame.point(vector(0.0, 0.0, 0.0))):
        T[:, k, 3] = part
    T[:, 3, 3] = 1.0
    return T


def joint_rows(q: Any, names: Sequence[str]) -> NDArray[np.float64]:
    """(n,) or (N, n) readings in the order of the names, of an array, a mapping or a table.

    Raises InputError for another number of columns, and for a name that is absent.
    """
    if isinstance(q, Mapping) or hasattr(q, "columns"):
        if absent := [name for name in names if name not in q]:
            raise unknown_name(f"the joint {absent[0]!r} is absent", absent[0], list(q))
        return np.stack([np.asarray(q[name], dtype=float) for name in names], axis=-1)
    rows = np.asarray(q, dtype=float)
    if rows.ndim not in (1, 2) or rows.shape[-1] != len(names):
        raise InputError(
            f"the readings have the shape {rows.shape}",
            code="wrong-shape",
            remedy=f"give (N, {len(names)}) numbers, or one row, in SI units: {listed(names)}",
        )
    return rows


def forward_kinematics(
    frame: Callable[[Values], Frame], q: Any, names: Sequence[str], *, each: bool = False
) -> NDArray[np.float64]:
    """(4, 4) or (N, 4, 4) T_base_body at readings as `joint_rows` takes them.

    each: whether the frame takes one pose at a time.
    """
    rows = joint_rows(q, names)
    every = np.atleast_2d(rows)
    if each:
        poses = (dict(zip(names, row, strict=True)) for row in every)
        T = np.concatenate([matrices(frame(x), 1) for x in poses])
    else:
        T = matrices(frame(dict(zip(names, every.T, strict=True))), len(every))
    return T[0] if rows.ndim == 1 else T


# A direction that is known nominally: the normal of a plane, gravity.


@dataclass(frozen=True)
class Direction:
    """The unit vector n = cos a cos b n_0 + sin a cos b e_1 + sin b e_2 near the nominal one.

    tilts: names of the parameters a and b [rad], in a plane a alone; axes: n_0, and e_1, e_2
    across it (for n_0 = z: x and y), (3,) each.
    """

    tilts: tuple[str, ...]
    axes: tuple[Array, Array, Array]

    @classmethod
    def near(
        cls, nominal: Sequence[float], *, name: str, what: str, dimension: int = 3
    ) -> Direction:
        """The direction with the parameters NAME_tilt_1 and NAME_tilt_2; nominal: of any length.

        what: how messages call it. Raises InputError for a vector without direction.
        """
        axes = _axes(nominal, f"the nominal {what} of {name!r}", dimension)
        return cls(tuple(f"{name}_tilt_{i}" for i in range(1, dimension)), axes)

    @property
    def declared(self) -> dict[str, Parameter]:
        """The parameters, nominal 0."""
        return {tilt: Parameter(tilt, 0.0, "rad") for tilt in self.tilts}

    def vector(self, p: Values) -> Vector:
        """n, (3,)."""
        n_0, e_1, e_2 = self.axes
        angles = [p[tilt] for tilt in self.tilts]
        n: Vector = np.cos(angles[0]) * n_0 + np.sin(angles[0]) * e_1
        for b in angles[1:]:
            n = np.cos(b) * n + np.sin(b) * e_2
        return n


def _axes(nominal: Sequence[float], called: str, dimension: int) -> tuple[Any, Any, Any]:
    vector = np.array(nominal, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(
            f"{called} is {list(nominal)}",
            code="invalid-value",
            remedy="give the three components of a direction, say [0, 0, 1]",
        )
    if dimension == 2 and vector[2]:
        raise InputError(
            f"{called} is {list(nominal)}, but the machine is planar",
            code="unsupported",
            remedy="give a direction in the plane, say [0, 1, 0]",
        )
    n_0 = vector / np.linalg.norm(vector)
    if dimension == 2:
        return n_0, np.array([-n_0[1], n_0[0], 0.0]), np.zeros(3)
    # The coordinate axis farthest from n_0, so that the projection loses no digits.
    least = np.eye(3)[int(np.argmin(np.abs(n_0)))]
    e_1 = least - (least @ n_0) * n_0
    e_1 /= np.linalg.norm(e_1)
    return n_0, e_1, np.cross(n_0, e_1)
