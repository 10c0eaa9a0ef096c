"""Where a moving body stands: what is fixed to it, seen in the base frame of its machine.

Everything is written with vectors of three; a machine that moves in a plane keeps z at zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from loopcal.expressions.vectors import rotate
from loopcal.mechanisms.chain import Step, apply

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
class BodyFrame:
    """A body by its rotation matrix R (3, 3) and origin o (3,): p_base = R p + o."""

    rotation: NDArray[Any]
    origin: Vector

    def point(self, p: Vector) -> Vector:
        """R p + o."""
        return self.direction(p) + self.origin

    def direction(self, v: Vector) -> Vector:
        """R v."""
        turned: Vector = self.rotation @ v
        return turned
