"""The product of exponentials against matrix exponentials of twists (SciPy)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials, merged
from tests.reference.frames import move, turn
from tests.refusals import refused

JOINTS = (
    ScrewJoint("q1", (0, 0, 1), (0.1, -0.2, 0.3)),
    ScrewJoint("q2", (0, -1, 0), (0.0, 0.1, 0.5)),
    ScrewJoint("q3", (0.6, 0, 0.8), (0.4, 0.0, 0.9)),
    ScrewJoint("q4", (1, 0, 0), kind="prismatic"),
)
HOME = ((0.5, 0.1, 1.2), (0.3, np.pi / 2, -0.4))


def exponential(joint, angle, axis=None, point=None):
    x, y, z = joint.axis if axis is None else axis
    q = np.array(joint.point if point is None else point)
    S = np.zeros((4, 4))
    if joint.kind == "prismatic":
        S[:3, 3] = x, y, z
    else:
        S[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        S[:3, 3] = -S[:3, :3] @ q
    return expm(S * angle)


def home():
    (xyz, (roll, pitch, yaw)) = HOME
    return move(*xyz) @ turn("z", yaw) @ turn("y", pitch) @ turn("x", roll)


def seen(machine, q, p):
    body = machine.frame(q, p)
    columns = [body.direction(v) for v in np.eye(3)]
    return np.column_stack([*columns, body.point(np.zeros(3))])


def test_it_equals_the_matrix_exponentials_of_its_twists():
    machine = exponentials(JOINTS, home=HOME)
    assert machine.quantities == {"q1": "rad", "q2": "rad", "q3": "rad", "q4": "m"}
    p = dict.fromkeys(machine.parameters, 0.0)
    for angles in np.random.default_rng(2).uniform(-3, 3, (20, 4)):
        T = np.eye(4)
        for joint, angle in zip(JOINTS, angles, strict=True):
            T = T @ exponential(joint, angle)
        q = dict(zip(machine.quantities, angles.tolist(), strict=True))
        np.testing.assert_allclose(seen(machine, q, p), (T @ home())[:3], atol=1e-13)


def test_its_parameters_displace_the_axes_and_leave_home_alone():
    machine = exponentials(JOINTS, home=HOME)
    assert list(machine.parameters) == [
        "q1_x", "q1_y", "q1_rx", "q1_ry", "q2_z", "q2_x", "q2_rz", "q2_rx",
        "q3_x", "q3_y", "q3_rx", "q3_ry", "q4_ry", "q4_rz",
    ]  # fmt: skip
    p = dict.fromkeys(machine.parameters, 0.0)
    p |= {"q1_x": 0.01, "q1_ry": 0.02, "q4_rz": 0.03}
    rest = dict.fromkeys(machine.quantities, 0.0)
    np.testing.assert_allclose(seen(machine, rest, p), home()[:3], atol=1e-15)
    axis = (turn("y", 0.02) @ [0, 0, 1, 1])[:3]
    T = exponential(JOINTS[0], 0.7, axis, (0.11, -0.2, 0.3)) @ home()
    np.testing.assert_allclose(seen(machine, rest | {"q1": 0.7}, p), T[:3], atol=1e-14)
    T = exponential(JOINTS[3], 0.7, (turn("z", 0.03) @ [1, 0, 0, 1])[:3]) @ home()
    np.testing.assert_allclose(seen(machine, rest | {"q4": 0.7}, p), T[:3], atol=1e-14)


def test_fixed_displacements_between_axes_are_one():
    steps = [Step("tx", constant=0.5), Step("ty", constant=1.0), Step("tx", constant=-0.5)]
    assert merged([*steps, Step("tx", "a")]) == (Step("ty", constant=1.0), Step("tx", "a"))


@pytest.mark.parametrize(
    ("joints", "code", "stated"),
    [([], "missing-key", ()), ([JOINTS[0], JOINTS[0]], "duplicate-name", ("'q1'",))],
)
def test_machines_that_are_none_are_refused(joints, code, stated):
    with refused(code, *stated):
        exponentials(joints)


@pytest.mark.parametrize(
    ("given", "code", "stated"),
    [
        ({"axis": (0, 0, 0.5)}, "invalid-value", ("0.5", "'elbow'")),
        ({"axis": (0, 0, 1), "kind": "fixed"}, "unknown-name", ("'fixed'",)),
    ],
)
def test_joints_that_are_none_are_refused(given, code, stated):
    with refused(code, *stated) as raised:
        ScrewJoint("elbow", **given)
    assert "'elbow'" in raised.value.message
