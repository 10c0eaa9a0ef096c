"""Backlash: where a joint stands within its play depends on where it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Joints, Name, joints
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter

# Gears of robots have plays of arc minutes; 1 mrad is 3.4 of them.
SD = {"rad": 1e-3, "m": 1e-3}
"""Prior sd of half a play, [rad] or [m]."""
JOINT = "{joint}"
Direction = Annotated[
    str,
    Key("Name of the known constant of each pose, +1, 0 or -1; {joint} is the name of the joint."),
]


def directions(mechanism: Mechanism) -> list[str]:
    """The known constants of a mechanism that are directions of approach: +1, 0 or -1."""
    effects = (mechanism.description or {}).get("effect", [])
    stated = [effect["direction"] for effect in effects if effect["type"] == "backlash"]
    return [
        name
        for name in mechanism.pose_constants
        if any(
            name == s.replace(JOINT, q) + e
            for s in stated
            for q in mechanism.quantities
            for e in ENDS
        )
    ]


@dataclass(frozen=True)
class Backlash:
    """Play of a joint: q' = q - JOINT_backlash * d, d the direction in which it was approached.

    d is a known constant of every pose: +1 where the reading grew until it stopped, -1 where it
    fell, 0 where the play was taken out. JOINT_backlash is half the play [rad or m]: what is
    driven lags behind. direction: name of that constant, in which {joint} stands for the joint's
    name.

    Raises InputError for a name that is the same for several joints.
    """

    joints: Joints = ("*",)
    direction: Direction = "{joint}_direction"
    name: Name = "backlash"

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """JOINT_backlash of each joint."""
        names = joints(mechanism, self.joints)
        if len(names) > 1 and JOINT not in self.direction:
            raise InputError(
                f"{len(names)} joints share the direction {self.direction!r}",
                code="duplicate-name",
                remedy=f"name one for each joint, as in direction = {Backlash.direction!r}",
            )
        units = mechanism.quantities
        return {
            f"{q}_backlash": Parameter(
                f"{q}_backlash", 0.0, units[q], SD.get(units[q], 1e-3), meaning=f"backlash of {q}"
            )
            for q in names
        }

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """The direction of each joint."""
        return {self._direction(joint): "1" for joint in joints(mechanism, self.joints)}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The readings less half the play."""
        return {
            joint: x[joint] - p[f"{joint}_backlash"] * x[self._direction(joint)]
            for joint in joints(mechanism, self.joints)
        }

    def _direction(self, joint: str) -> str:
        return self.direction.replace(JOINT, joint)
