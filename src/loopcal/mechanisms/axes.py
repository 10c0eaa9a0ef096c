"""Motion of a joint about any axis, as elementary steps: exp([S] theta) = A Rz(theta) A^-1.

A is the frame of the axis. Its steps may carry parameters, which then move the axis alone: what
comes behind the joint stays where it was at theta = 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step

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
