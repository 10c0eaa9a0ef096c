"""Chains of elementary transforms, the common language of all serial conventions.

A step moves along or turns about one coordinate axis of the current frame by

    amount = constant + sign * parameter + direction * joint reading      [m or rad]

and a chain is the product of its steps, from the instrument's frame to the tool point:
p_instrument = S_1 S_2 ... S_n p_tool. Tz Rz means: first move along z, then turn about the new z.

Motion of a joint about any axis, as elementary steps: exp([S] theta) = A Rz(theta) A^-1.

A is the frame of the axis. Its steps may carry parameters, which then move the axis alone: what
comes behind the joint stays where it was at theta = 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, refuse_repeated
from loopcal.expressions.vectors import PLANES, rotate, vector
from loopcal.keys import Key
from loopcal.mechanisms.parameters import Parameter, Role

MOST_JOINTS = 64
"""Of one chain: loops and derivatives of longer ones take minutes and gigabytes to derive."""
MOTIONS = ("tx", "ty", "tz", "rx", "ry", "rz")
BASE = "base"
"""Owner of what stands ahead of the first joint."""
_WORDS = {"t": "shift along", "r": "turn about"}


def refuse_long_chain(joints: int) -> None:
    """Raise InputError for a chain of more than 64 joints."""
    if joints > MOST_JOINTS:
        raise InputError(
            f"the chain has {joints} joints; the limit is {MOST_JOINTS}",
            code="too-large",
            remedy="calibrate a shorter part of it (another base or tip)",
        )


def check_joints(names: Sequence[str]) -> None:
    """Raise InputError for a chain of more than 64 joints, and for two of one name."""
    refuse_long_chain(len(names))
    refuse_repeated(names, "two joints are named {!r}")


@dataclass(frozen=True)
class Step:
    """One elementary transform: a translation (tx, ty, tz) or rotation (rx, ry, rz)."""

    motion: str
    parameter: str | None = None
    joint: str | None = None
    direction: float = 1
    constant: float = 0.0
    sign: int = 1

    @property
    def unit(self) -> str:
        """SI unit of the amount."""
        return "m" if self.motion[0] == "t" else "rad"

    def amount(self, joints: Mapping[str, Any], parameters: Mapping[str, Any]) -> Any:
        """constant + sign * parameter + direction * joint, for numbers or traced values."""
        total: Any = self.constant
        if self.parameter is not None:
            value = parameters[self.parameter]
            total = total + value if self.sign > 0 else total - value
        if self.joint is not None:
            reading = joints[self.joint]
            # A product by 1 would be one more operation in every loop of the tape.
            if abs(self.direction) != 1:
                reading = abs(self.direction) * reading
            total = total + reading if self.direction > 0 else total - reading
        return total

    def inverse(self) -> Step:
        """The step that undoes this one."""
        return replace(self, constant=-self.constant, sign=-self.sign, direction=-self.direction)


def chain_parameters(steps: Sequence[Step]) -> dict[str, Parameter]:
    """The parameters of a chain, nominally 0, each owned by the joint whose motion it follows."""
    made: dict[str, Parameter] = {}
    owner = BASE
    for step in steps:
        owner = step.joint or owner
        if step.parameter is None or step.parameter in made:
            continue
        behind = "before the first joint" if owner == BASE else f"after {owner}"
        made[step.parameter] = (
            _geometry(step, owner, behind)
            if step.joint is None
            else Parameter(step.parameter, 0.0, step.unit).of("zero", owner, zero_of(owner))
        )
    return made


def zero_of(joint: str) -> str:
    """What the zero of a joint is, in words."""
    return f"zero of {joint}: added to its reading"


def axis_parameters(joint: str, steps: Iterable[Step]) -> dict[str, Parameter]:
    """The parameters that move the axis of a joint, nominally 0."""
    return {str(s.parameter): _geometry(s, joint, f"at {joint}") for s in steps if s.parameter}


def _geometry(step: Step, owner: str, where: str) -> Parameter:
    role: Role = "length" if step.unit == "m" else "twist"
    meaning = f"{_WORDS[step.motion[0]]} the {step.motion[1]} axis {where}"
    return Parameter(str(step.parameter), 0.0, step.unit, role=role, owner=owner, meaning=meaning)


def apply(
    steps: Sequence[Step],
    point: NDArray[Any],
    joints: Mapping[str, Any],
    parameters: Mapping[str, Any],
) -> NDArray[Any]:
    """The point of the last frame, seen in the first: S_1 ... S_n point, from tip to base."""
    # A point turned step by step costs fewer operations of the tape than a product of matrices.
    for step in reversed(steps):
        amount = step.amount(joints, parameters)
        axis = step.motion[1]
        if step.motion[0] == "r":
            point = rotate(axis, amount, point)
        else:
            moved = list(point)
            moved["xyz".index(axis)] = moved["xyz".index(axis)] + amount
            point = vector(*moved)
    return point


def matrix(step: Step, amount: float) -> NDArray[np.float64]:
    """The 4x4 matrix of one step."""
    T = np.eye(4)
    axis = step.motion[1]
    if step.motion[0] == "t":
        T["xyz".index(axis), 3] = amount
    else:
        i, j = PLANES[axis]
        T[i, i] = T[j, j] = math.cos(amount)
        T[j, i] = math.sin(amount)
        T[i, j] = -T[j, i]
    return T


def product(
    steps: Sequence[Step], joints: Mapping[str, float], parameters: Mapping[str, float]
) -> NDArray[np.float64]:
    """The 4x4 matrix of a chain: T_first_last."""
    T = np.eye(4)
    for step in steps:
        T = T @ matrix(step, float(step.amount(joints, parameters)))
    return T


def frames(
    steps: Sequence[Step],
    joints: Mapping[str, NDArray[np.float64]],
    parameters: Mapping[str, float],
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """The frames ahead of each step and behind the last, at joint readings (N,).

    Of each R (N, 3, 3) and the origin (N, 3), both in the first frame.
    """
    count = len(next(iter(joints.values())))
    R, origin = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
    yield R, origin
    for step in steps:
        amount = np.broadcast_to(step.amount(joints, parameters), (count,))[:, None]
        if step.motion[0] == "t":
            origin = origin + R[:, :, "xyz".index(step.motion[1])] * amount
        else:
            i, j = PLANES[step.motion[1]]
            c, s = np.cos(amount), np.sin(amount)
            turned = R.copy()
            turned[:, :, i] = c * R[:, :, i] + s * R[:, :, j]
            turned[:, :, j] = c * R[:, :, j] - s * R[:, :, i]
            R = turned
        yield R, origin


def last_frame(
    steps: Sequence[Step], joints: Mapping[str, Any], parameters: Mapping[str, float], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """R (N, 3, 3) and origin (N, 3) of the last of `frames` at readings (N,) of `count` poses."""
    # Each axis a row of components (3, N): a step touches two of them at most, and sees all poses.
    axes = [np.repeat(axis[:, None], count, axis=1) for axis in np.eye(3)]
    origin = np.zeros((3, count))
    for step in steps:
        amount = step.amount(joints, parameters)
        if step.motion[0] == "t":
            origin = origin + axes["xyz".index(step.motion[1])] * amount
        else:
            i, j = PLANES[step.motion[1]]
            c, s = np.cos(amount), np.sin(amount)
            axes[i], axes[j] = c * axes[i] + s * axes[j], c * axes[j] - s * axes[i]
    R = np.ascontiguousarray(np.array(axes).transpose(2, 1, 0))
    return R, np.ascontiguousarray(origin.T)


Triple = tuple[float, float, float]
JointName = Annotated[str, Key("The quantity that is read; begins the names of its parameters.")]


def moved_in(joint: Any) -> str:
    """SI unit in which a joint moves, by its kind."""
    return "m" if joint.kind == "prismatic" else "rad"


Limits = Annotated[
    tuple[float, float] | None,
    Key("Range of the reading, within which identifiable parameters are chosen.", unit=moved_in),
]
ROUNDED = 1e-3
"""How far from 1 the norm of a direction may be: digits were left out when it was written."""
_CYCLE = {"x": "yzx", "y": "zxy", "z": "xyz"}


@dataclass(frozen=True)
class AxisFrame:
    """A frame one of whose axes is the joint's.

    turns: fixed rotations into it, none where the joint's axis is a coordinate axis; letters:
    its two axes normal to the joint's, in cyclic order, and the joint's; sign: -1 where the
    joint's axis runs against that letter.
    """

    turns: tuple[Step, ...]
    letters: str
    sign: int

    @classmethod
    def of(cls, axis: Sequence[float], joint: str) -> AxisFrame:
        """The frame of a direction, given as a unit vector.

        Raises InputError for a direction of another length than 1.
        """
        x, y, z = unit_direction(axis, joint)
        along = [letter for letter, v in zip("xyz", (x, y, z), strict=True) if v != 0.0]
        if len(along) == 1:
            return cls((), _CYCLE[along[0]], 1 if x + y + z > 0.0 else -1)
        # Rz Ry bring z onto the direction: its azimuth, then its angle to z.
        turns = (
            Step("rz", constant=math.atan2(y, x)),
            Step("ry", constant=math.atan2(math.hypot(x, y), z)),
        )
        return cls(turns, _CYCLE["z"], 1)

    def moving(
        self,
        joint: str,
        kind: str,
        displacement: Sequence[Step] = (),
        direction: float = 1.0,
        constant: float = 0.0,
    ) -> list[Step]:
        """The joint's motion by constant + direction * reading.

        own: steps with parameters that displace the axis, in this frame.
        """
        placed = [*self.turns, *displacement]
        motion = ("t" if kind == "prismatic" else "r") + self.letters[2]
        moved = Step(
            motion, joint=joint, direction=self.sign * direction, constant=self.sign * constant
        )
        # The axis frame is left again: its parameters move the axis and nothing behind the joint.
        return [*placed, moved, *(step.inverse() for step in reversed(placed))]


def unit_direction(axis: Sequence[float], joint: str) -> Triple:
    """The direction with norm 1, where rounding has left it a little off.

    Raises InputError for a vector that is no direction, or has not been normalised.
    """
    x, y, z = (float(v) for v in axis)
    norm = math.hypot(x, y, z)
    if norm == 0.0 or not math.isfinite(norm):
        raise InputError(
            f"the axis ({x:g}, {y:g}, {z:g}) of the joint {joint!r} is zero or not finite",
            code="invalid-value",
            remedy="give a unit vector, as 0 0 1 for the z axis",
        )
    unit = (x / norm, y / norm, z / norm)
    if abs(norm - 1.0) > ROUNDED:
        words = " ".join(f"{v:.9g}" for v in unit)
        raise InputError(
            f"the axis ({x:g}, {y:g}, {z:g}) of the joint {joint!r} has the norm {norm:.6g}; a "
            f"unit vector is needed",
            code="invalid-value",
            remedy=f"write {words} if this direction is meant; otherwise check the digits",
        )
    return unit


def fixed_frame(xyz: Sequence[float], rpy: Sequence[float]) -> list[Step]:
    """A frame that does not move: Tx Ty Tz Rz(yaw) Ry(pitch) Rx(roll), without what is zero."""
    roll, pitch, yaw = rpy
    amounts = (*xyz, yaw, pitch, roll)
    motions = ("tx", "ty", "tz", "rz", "ry", "rx")
    return [Step(m, constant=v) for m, v in zip(motions, amounts, strict=True) if v != 0.0]
