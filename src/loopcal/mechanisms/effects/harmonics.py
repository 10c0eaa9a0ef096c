"""Gears and encoders that are not round: errors that repeat with the turning joint."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Joints, Name, joints
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter

SD = 1e-3
"""Prior sd [rad] of an amplitude: a graduation 50 um off centre on a radius of 50 mm."""

Orders = Annotated[
    tuple[float, ...], Key("Orders k of the harmonics, per turn of the joint.", positive=True)
]


@dataclass(frozen=True)
class Harmonics:
    """Eccentricity of an encoder (order 1), its ellipticity (2), teeth of a gear (its ratio).

    theta' = theta + sum_k (JOINT_cosK cos(k theta) + JOINT_sinK sin(k theta)) [rad]

    joints: names or globs; orders: k > 0, not whole where a wheel turns with another ratio. A disc
    that is e off centre and read at a radius r is wrong by (e / r) sin(theta - theta_0). An
    elliptic one errs with twice the angle, a gear with its ratio. Part of order 1 looks like
    geometry: the joint's axis, or what it carries, displaced; the prior decides what the poses
    leave open.

    Raises InputError for an order that is not positive, or given twice, or none.
    """

    joints: Joints = ("*",)
    orders: Orders = (1.0, 2.0)
    name: Name = "harmonics"

    def __post_init__(self) -> None:
        if not self.orders or any(not k > 0.0 or math.isinf(k) for k in self.orders):
            raise InputError(
                f"the orders of {self.name!r} are {list(self.orders)}",
                code="invalid-value",
                remedy="give positive numbers: 1 for once per turn of the joint",
            )
        if len({f"{k:.12g}" for k in self.orders}) < len(self.orders):
            raise InputError(
                f"the orders of {self.name!r} are {list(self.orders)}, one of them twice",
                code="duplicate-name",
                remedy="give each order once",
            )

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """JOINT_cosK and JOINT_sinK [rad] of each joint and order."""
        return {
            name: Parameter(name, 0.0, "rad", SD, meaning=_meaning(joint, k, part))
            for joint in joints(mechanism, self.joints, "rad")
            for k in self.orders
            for name, part in (
                (f"{joint}_cos{k:.12g}", "cosine"),
                (f"{joint}_sin{k:.12g}", "sine"),
            )
        }

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """None."""
        return {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The angles with their harmonics."""
        return {joint: self._turned(joint, x, p) for joint in joints(mechanism, self.joints, "rad")}

    def _turned(self, joint: str, x: Values, p: Values) -> Any:
        total = theta = x[joint]
        for k in self.orders:
            total = total + p[f"{joint}_cos{k:.12g}"] * np.cos(k * theta)
            total = total + p[f"{joint}_sin{k:.12g}"] * np.sin(k * theta)
        return total


_TIMES = {1.0: "once-per-turn", 2.0: "twice-per-turn"}


def _meaning(joint: str, order: float, part: str) -> str:
    """What an amplitude is, in words."""
    times = _TIMES.get(order, f"{order:.12g}-per-turn")
    return f"{times} gear error of {joint}, {part} part"
