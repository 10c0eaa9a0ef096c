"""The body that instruments look at, displaced a little from where the geometry puts it.

An arm bends, a platform tilts: whatever the cause, all that is fixed to one body moves with it.
The loops of a mechanism are therefore kept once more, with the displacements of its bodies as
further inputs. Each is a shift d and a small turn w about the body's origin b, in the machine's
base frame:

    p' = p + d + w x (p - b),    v' = v + w x v,    for points p and directions v of the body.

What stands in their place is a matter of the model of the machine's errors (`structure`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from loopcal.expressions.tape import Tape
from loopcal.expressions.vectors import cross, vector
from loopcal.mechanisms.frame import Frame, Vector

MOTIONS = {3: ("x", "y", "z", "rx", "ry", "rz"), 2: ("x", "y", "rz")}


@dataclass(frozen=True)
class Body:
    """A mechanism whose bodies can be displaced.

    tape: the loops, with the displacements as parameters behind those of the mechanism;
    displacements: by body, for each pose of a row, the names of dx, dy, dz [m] and wx, wy, wz
    [rad], in a plane dx, dy and wz; mounted: for each thing on a body, the parameters that say
    where it sits there; turning: the bodies of which it is read how they are turned: several
    points of them are looked at, or their orientation.
    """

    tape: Tape
    displacements: Mapping[str, tuple[tuple[str, ...], ...]]
    mounted: tuple[tuple[str, ...], ...]
    turning: frozenset[str]

    @property
    def axes(self) -> tuple[str, ...]:
        """Along and about which axes it is displaced: x, y, z, rx, ry, rz; in a plane x, y, rz."""
        return MOTIONS[2 if self.planar else 3]

    @property
    def planar(self) -> bool:
        """Whether the machine moves in a plane."""
        first, *_ = next(iter(self.displacements.values()))
        return len(first) == len(MOTIONS[2])


def displacement_names(body: str, dimension: int, end: str) -> tuple[str, ...]:
    """Names of the displacements of a body in a pose of a row: BODY:x, ..., BODY:rz."""
    return tuple(f"{body}:{motion}{end}" for motion in MOTIONS[dimension])


@dataclass(frozen=True)
class Displaced:
    """A frame displaced by a shift and a small turn about its origin, (3,) each."""

    frame: Frame
    shift: Vector
    turn: Vector

    @classmethod
    def by(cls, frame: Frame, names: tuple[str, ...], values: Mapping[str, Any]) -> Displaced:
        """The frame displaced by the inputs of these names."""
        inputs = [values[name] for name in names]
        if len(inputs) == len(MOTIONS[2]):
            return cls(frame, vector(inputs[0], inputs[1], 0.0), vector(0.0, 0.0, inputs[2]))
        return cls(frame, vector(*inputs[:3]), vector(*inputs[3:]))

    def point(self, p: Vector) -> Vector:
        """p + d + w x (p - b)."""
        placed: Vector = self.frame.point(p)
        arm = placed - self.frame.point(vector(0.0, 0.0, 0.0))
        # To first order in w a turn about b is p + w x (p - b); bodies bend by milliradians.
        moved: Vector = placed + self.shift + cross(self.turn, arm)
        return moved

    def direction(self, v: Vector) -> Vector:
        """v + w x v."""
        rotated = self.frame.direction(v)
        turned: Vector = rotated + cross(self.turn, rotated)
        return turned
