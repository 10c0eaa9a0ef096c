"""Readings with a scale of their own: a gear ratio, an encoder's pitch, a wire's drum."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Readings with a scale error: theta' = theta (1 + JOINT_scale), turning or sliding.

    Lengths that an instrument reads have one where `joints` names them: wire (1 + wire_scale).
    """

    joints: Joints = ("*",)
    name: Name = "scale"

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """NAME_scale of each joint or length."""
        joints = {f"{name}_scale": name for name in _scaled(mechanism, self.joints)}
        return {
            name: Parameter(name, 0.0, "1", SD, meaning=f"scale of {joint}")
            for name, joint in joints.items()
        }

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """None."""
        return {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The readings scaled."""
        scaled = _scaled(mechanism, self.joints)
        return {name: x[name] * (1.0 + p[f"{name}_scale"]) for name in scaled}


def _scaled(mechanism: Mechanism, patterns: Sequence[str]) -> list[str]:
    """Joints by names or globs, and lengths that instruments read by their names."""
    lengths = {q for family in mechanism.families for q in family.readings}
    lengths &= {q for q, unit in mechanism.quantities.items() if unit == "m"}
    named = [name for name in patterns if name in lengths]
    others = [name for name in patterns if name not in lengths]
    return [*(joints(mechanism, others) if others else []), *dict.fromkeys(named)]
