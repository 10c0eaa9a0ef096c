"""Chains of elementary transforms, the common language of all serial conventions.

A step moves along or turns about one coordinate axis of the current frame by

    amount = constant + sign * parameter + direction * joint reading      [m or rad]

and a chain is the product of its steps, from the instrument's frame to the tool point:
p_instrument = S_1 S_2 ... S_n p_tool. Tz Rz means: first move along z, then turn about the new z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.expressions.vectors import PLANES, rotate, vector

MOST_JOINTS = 64
"""Of one chain: loops and derivatives of longer ones take minutes and gigabytes to derive."""
MOTIONS = ("tx", "ty", "tz", "rx", "ry", "rz")


def refuse_long_chain(joints: int) -> None:
    """Raise InputError for a chain of more than 64 joints."""
    if joints > MOST_JOINTS:
        raise InputError(
            f"the chain has {joints} joints; the limit is {MOST_JOINTS}",
            code="too-large",
            remedy="calibrate a shorter part of it (another base or tip)",
        )


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
            if abs(self.direction) != 1:
                reading = abs(self.direction) * reading
            total = total + reading if self.direction > 0 else total - reading
        return total

    def inverse(self) -> Step:
        """The step that undoes this one."""
        return replace(self, constant=-self.constant, sign=-self.sign, direction=-self.direction)


def apply(
    steps: Sequence[Step],
    point: NDArray[Any],
    joints: Mapping[str, Any],
    parameters: Mapping[str, Any],
) -> NDArray[Any]:
    """The point of the last frame, seen in the first: S_1 ... S_n point, from tip to base."""
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
