"""The machines that laws must hold for, with plausible dimensions, by name."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import Joint, serial_arm

MA1400_TOOL = {"z1": 1.4159, "x6B": 0.05, "y6B": 0.0, "z6B": -0.45}
"""Height of the shoulder and the left arm's reflector, for the ready made MA1400."""


def _dh(form: str, numbers: list[tuple[float, float, float, float]]) -> dict[str, float]:
    keys = ("a", "alpha", "beta", "offset") if form == "hayati" else ("a", "d", "alpha", "offset")
    return {
        f"{key}_{i}": value
        for i, row in enumerate(numbers, 1)
        for key, value in zip(keys, row, strict=True)
    }


SIX = [
    (0.15, 0.45, -pi / 2, 0.1),
    (0.61, 0.02, pi - 0.01, -pi / 2),
    (0.20, 0.01, -pi / 2, 0.02),
    (0.01, -0.64, pi / 2, 0.0),
    (0.03, 0.01, pi / 2, -pi / 2),
    (0.01, 0.20, 0.1, 0.3),
]
BASE = {
    "base_x": 1.2,
    "base_y": -0.4,
    "base_z": 0.3,
    "base_rz": 2.1,
    "base_ry": 0.2,
    "base_rx": -0.1,
}
TOOL = {"tool_x": 0.05, "tool_y": -0.02, "tool_z": 0.15}
DIRECTIONS = (1, -1, 1, -1, 1, 1)


def two_link(x: Any, p: Any) -> Any:
    """The loops of a planar arm, as a user writes them."""
    a = x.phi2 + p.phi20
    b = a + x.phi3 + p.phi30
    return (
        p.xA + p.l2 * np.cos(a) + p.l3 * np.cos(b) - x.xP,
        p.yA + p.l2 * np.sin(a) + p.l3 * np.sin(b) - x.yP,
    )


def dh_arm(form: str = "dh") -> Mechanism:
    """Six revolute joints in one convention, some of them counting backwards."""
    joints = [Joint(f"q{i}", form, direction=d) for i, d in enumerate(DIRECTIONS, 1)]
    return serial_arm(joints, _dh(form, SIX) | BASE | TOOL, name=f"{form} arm")


def mixed_arm() -> Mechanism:
    """All conventions in one arm, prismatic joints, fixed motions before and after."""
    joints = [
        Joint("q1", "dh", before={"rx": 0.3, "tz": 0.2}),
        Joint("q2", "hayati", direction=-1, after={"ty": 0.1}),
        Joint("q3", "dh", kind="prismatic"),
        Joint("q4", "mdh", kind="prismatic", direction=-1),
        Joint("q5", "transition-y", after={"rz": 0.4, "tx": -0.1}),
        Joint("q6", "hayati", kind="prismatic"),
        Joint("q7", "transition-x", kind="prismatic", before={"ry": 0.2}),
    ]
    arm = serial_arm(joints, BASE | TOOL, name="mixed arm")
    rng = np.random.default_rng(11)
    free = [p.name for p in arm.parameters if not p.name.startswith(("base", "tool"))]
    return arm.with_nominal({name: float(rng.uniform(-0.5, 0.5)) for name in free})


def gantry() -> Mechanism:
    """Three prismatic joints along x, y, z, told by transitions alone."""
    joints = [Joint(f"q{a}", f"transition-{a}", kind="prismatic") for a in "xyz"]
    return serial_arm(joints, {"x3B": 0.1, "y3B": 0.0, "z3B": -0.2}, name="gantry")


MACHINES: dict[str, Mechanism] = {
    "planar": planar_two_link({"phi20": 0.1, "phi30": -0.2}),
    "MA1400": motoman_ma1400(MA1400_TOOL),
    "dh": dh_arm("dh"),
    "mdh": dh_arm("mdh"),
    "hayati": dh_arm("hayati"),
    "mixed": mixed_arm(),
    "gantry": gantry(),
}
