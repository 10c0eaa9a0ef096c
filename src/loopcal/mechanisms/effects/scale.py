"""Joints whose readings have a scale of their own: a gear ratio, a linear encoder's pitch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from loopcal.mechanisms.effects.effect import Joints, Name, joints
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter

SD = 1e-3
"""Prior sd of a scale: a tooth more or less would be off by more than ten times as much."""


@dataclass(frozen=True)
class Scale:
    """Readings with a scale error: theta' = theta (1 + JOINT_scale), turning or sliding."""

    joints: Joints = ("*",)
    name: Name = "scale"

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """JOINT_scale of each joint."""
        names = [f"{joint}_scale" for joint in joints(mechanism, self.joints)]
        return {name: Parameter(name, 0.0, "1", SD) for name in names}

    def known(self, mechanism: Mechanism) -> dict[str, str]:
        """None."""
        return {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The readings scaled."""
        found = joints(mechanism, self.joints)
        return {joint: x[joint] * (1.0 + p[f"{joint}_scale"]) for joint in found}
