"""One robot, three descriptions, the same data: the same machine comes out.

The UR10 by Denavit and Hartenberg (Hayati's form for its parallel axes), by the origins of its
URDF, and as a product of exponentials. Each has 27 identifiable parameters, and each can take the
shape of every arm of six revolute joints near the nominal one: six lines, 4 numbers each, and a
point, 3. The estimate of greatest likelihood is a machine, not numbers, so it is the same.
"""

from __future__ import annotations

from functools import cache
from math import pi

import numpy as np
import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.redundancy import redundant, without_redundant
from loopcal.mechanisms.serial import Joint, serial_arm
from loopcal.simulation.simulate import simulate
from tests.reference.plain_tape import loop_values
from tests.reference.robots import urdf_of

JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
TOOL = {"tool_x": 0.04, "tool_y": -0.03, "tool_z": 0.11}
SDS = {**dict.fromkeys(JOINTS, 5e-5), **dict.fromkeys("xyz", 2e-5)}


def by_denavit_and_hartenberg() -> Mechanism:
    """The dimensions that Universal Robots publish; axes 2, 3 and 4 are parallel."""
    forms = ("dh", "hayati", "hayati", "dh", "dh", "dh")
    a, d = (0, -0.612, -0.5723, 0, 0, 0), (0.1273, 0, 0, 0.163941, 0.1157, 0.0922)
    alpha = (pi / 2, 0, 0, pi / 2, -pi / 2, 0)
    nominal = {f"a_{i}": v for i, v in enumerate(a, 1)}
    nominal |= {f"alpha_{i}": v for i, v in enumerate(alpha, 1)}
    nominal |= {f"d_{i}": v for i, v in enumerate(d, 1) if forms[i - 1] == "dh"}
    # the frame of the controller is turned by half a turn against base_link
    joints = [Joint(name, form) for name, form in zip(JOINTS, forms, strict=True)]
    arm = serial_arm(joints, nominal | TOOL | {"base_rz": pi})
    first = [n for n in arm.parameters.names if n.startswith(("base", "tool"))]
    return without_redundant(arm, redundant(arm, first=first))


def by_urdf() -> Mechanism:
    data = {"type": "urdf", "file": str(urdf_of("UR10")), "base": "base_link", "tip": "tool0"}
    return mechanism_from_data(data | {"parameters": TOOL_ENTRIES}, "")


def by_exponentials() -> Mechanism:
    axes = ([0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0, -1], [0, 1, 0])
    points = (
        [0, 0, 0], [0, 0, 0.1273], [0.612, 0, 0.1273], [1.1843, 0, 0.1273],
        [1.1843, 0.163941, 0], [1.1843, 0, 0.0116],
    )  # fmt: skip
    named = zip(JOINTS, axes, points, strict=True)
    joints = [{"name": n, "axis": w, "point": q} for n, w, q in named]
    home = {"xyz": [1.1843, 0.256141, 0.0116], "rpy": [-pi / 2, pi, 0]}
    data = {"type": "exponentials", "joint": joints, "home": home, "parameters": TOOL_ENTRIES}
    return mechanism_from_data(data, "")


TOOL_ENTRIES = {name: {"value": value} for name, value in TOOL.items()}
WAYS = {
    "DH": by_denavit_and_hartenberg,
    "URDF": by_urdf,
    "exponentials": by_exponentials,
}


def reached(arm: Mechanism, joints: np.ndarray) -> np.ndarray:
    """The measured point, (3, N), at joints (6, N)."""
    given = dict(zip(JOINTS, joints, strict=True))
    zero = np.zeros(joints.shape[1])
    p = np.array([p.nominal for p in arm.parameters])[:, None]
    x = np.array([given.get(q, zero) for q in arm.tape.quantities])
    return np.array(loop_values(arm.tape, x, np.broadcast_to(p, (len(p), joints.shape[1]))))


@cache
def calibrated(way: str) -> Mechanism:
    """From readings of a robot that is off its nominal shape, with noise."""
    robot, rng = by_urdf(), np.random.default_rng(3)
    truth = {
        p.name: p.nominal + rng.normal(0.0, 1e-3 if p.unit == "m" else 2e-3)
        for p in robot.parameters  # those that the estimators hold fixed too
    }
    truth |= {"base_x": 1.9, "base_y": -0.6, "base_z": 0.3, "base_rz": 1.1}
    joints = dict(zip(JOINTS, rng.uniform(-2.5, 2.5, (6, 120)), strict=True))
    made = simulate(robot, joints, noise=Noise(SDS), seed=1, truth=truth)
    result = calibrate(WAYS[way](), made.dataset, noise=Noise(SDS))
    assert result.status.converged
    assert len(result.estimated) == 27
    assert result.chi_squared is not None
    assert (result.chi_squared.p_value or 0.0) > 1e-3
    return result.mechanism.with_nominal(dict(result.value))


@pytest.mark.parametrize("way", ["DH", "exponentials"])
def test_nominally_all_are_the_same_robot(way: str) -> None:
    joints = np.random.default_rng(1).uniform(-pi, pi, (6, 200))
    np.testing.assert_allclose(
        reached(WAYS[way](), joints), reached(by_urdf(), joints), rtol=0, atol=2e-11
    )  # the URDF writes right angles with 12 digits


@pytest.mark.parametrize("way", ["DH", "exponentials"])
def test_calibrated_all_predict_the_same_points(way: str) -> None:
    joints = np.random.default_rng(2).uniform(-pi, pi, (6, 1000))
    one, other = reached(calibrated(way), joints), reached(calibrated("URDF"), joints)
    assert np.abs(one - other).max() < 1e-9
