"""The Yaskawa Motoman MA1400 as the seed models it (chapter 5): 27 parameters, point measured.

T01 = Tx(x0) Ty(y0) Rx(phix0) Ry(phiy0) Rz(theta_1); T12 and T23 about y, T34 about x, T45 about y,
T56 about z; tool point (x6B, y6B, z6B): complete and minimal for positions, and
free of singularities at parallel axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated

from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, Motions, serial_arm

AXES = "zyyxyz"
DIRECTIONS = (1, 1, -1, -1, -1, -1)
"""Sign of each joint's reading about its axis: S, L, U, R, B, T of the controller."""

NOMINAL = {
    "x1": 0.150,
    "z2": 0.614,
    "z3": 0.200,
    "x4": 0.640,
    "x5": 0.030,
    "x6B": 0.020,
    "y6B": -0.070,
    "z6B": -0.350,
}
"""The drawing's lengths [m]; the tool point is that of the seed's reflector, rounded."""


def motoman_ma1400(
    nominal: Mapping[str, float | Parameter] | None = None,
    *,
    before: Motions = MappingProxyType({}),
    name: Annotated[str, Key("Name of the machine.")] = "Motoman MA1400",
) -> Mechanism:
    """The MA1400 arm with the seed's 27 parameters; joints theta_1 to theta_6, point x, y, z.

    nominal: values [SI] by name that replace the drawing's; before: fixed motions ahead of the
    first joint, as a `Joint` takes them, say {"rz": pi / 2} for an instrument that sees the arm
    turned so far that x1 and y3 would run away. Source: seed, chapter 5.
    """
    joints = list(motoman_joints())
    joints[0] = replace(joints[0], before=dict(before))
    made = serial_arm(joints, {**NOMINAL, **(nominal or {})}, name=name)
    described = {"type": "motoman-ma1400", "before": joints[0].before}
    return replace(made, description=described)


def motoman_joints() -> tuple[Joint, ...]:
    """The six joints, theta_1 to theta_6."""
    return tuple(
        Joint(f"theta_{i}", f"transition-{axis}", direction=direction)
        for i, (axis, direction) in enumerate(zip(AXES, DIRECTIONS, strict=True), 1)
    )
