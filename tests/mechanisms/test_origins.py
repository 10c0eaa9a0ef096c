"""Chains of joint origins against matrices written out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint, Mimic, joint_chain
from tests.reference.frames import move, turn
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

CHAIN = (
    LinkJoint("lift", "prismatic", (0.1, 0.2, 0.3), (0.1, -0.2, 0.3), (0, 0, -1)),
    LinkJoint("plate", "fixed", (0.0, 0.1, 0.0), (0.0, np.pi / 2, 0.0)),
    LinkJoint("arm", "continuous", (0.4, 0.0, 0.0), (1.0, 0.0, 0.0), (0.6, 0.8, 0.0)),
    LinkJoint(
        "hand", "revolute", (0, 0, 0.5), axis=(0, 1, 0), mimic=Mimic("arm", -0.5, 0.2, "continuous")
    ),
)


def origin(joint, p):
    n = joint.name
    roll, pitch, yaw = joint.rpy
    return (
        move(p[f"{n}_x"], p[f"{n}_y"], p[f"{n}_z"])
        @ (turn("z", yaw) @ turn("y", pitch) @ turn("x", roll))
        @ (turn("z", p[f"{n}_rz"]) @ turn("y", p[f"{n}_ry"]) @ turn("x", p[f"{n}_rx"]))
    )


def about(azimuth, angle):
    return turn("z", azimuth) @ turn("x", angle) @ turn("z", -azimuth)


def frame(p, lift, arm):
    return (
        origin(CHAIN[0], p)
        @ move(z=-lift)
        @ origin(CHAIN[1], p)
        @ origin(CHAIN[2], p)
        @ about(np.arctan2(0.8, 0.6), arm)
        @ origin(CHAIN[3], p)
        @ turn("y", -0.5 * arm + 0.2)
    )


def test_origins_axes_and_mimics_equal_their_matrices():
    machine = joint_chain(CHAIN)
    assert machine.quantities == {"lift": "m", "arm": "rad"}
    rng = np.random.default_rng(1)
    p = {n: v.nominal + rng.normal(0.0, 0.3) for n, v in machine.parameters.items()}
    for lift, arm in rng.uniform(-2.0, 2.0, (20, 2)):
        body, T = machine.frame({"lift": lift, "arm": arm}, p), frame(p, lift, arm)
        for v in np.eye(3):
            np.testing.assert_allclose(body.point(v), T[:3, :3] @ v + T[:3, 3], atol=1e-14)
            np.testing.assert_allclose(body.direction(v), T[:3, :3] @ v, atol=1e-14)


def test_the_parameters_are_the_origins_own_numbers():
    machine = joint_chain(CHAIN)
    nominal = {n: v.nominal for n, v in machine.parameters.items()}
    assert [nominal[f"lift_{a}"] for a in "xyz"] == [0.1, 0.2, 0.3]
    assert all(nominal[f"lift_r{a}"] == 0.0 for a in "xyz")
    assert len(nominal) == 6 * len(CHAIN)


def test_axes_have_two_tilts_each_that_leave_the_zero_pose_alone():
    machine = joint_chain(CHAIN, axes=True)
    tilts = [n for n in machine.parameters if "_axis_" in n]
    assert tilts == [
        "lift_axis_rx", "lift_axis_ry", "arm_axis_rx", "arm_axis_ry", "hand_axis_rz", "hand_axis_rx"
    ]  # fmt: skip
    plain = {n: v.nominal for n, v in machine.parameters.items()}
    tilted = plain | {"arm_axis_rx": 0.1, "lift_axis_ry": -0.2}
    still = {"lift": 0.0, "arm": 0.0}
    for q, equal in ((still, True), ({"lift": 0.1, "arm": 0.5}, False)):
        a, b = (machine.frame(q, p).point(np.ones(3)) for p in (plain, tilted))
        assert np.allclose(a, b, atol=1e-14) is equal


def test_seen_by_an_instrument_it_is_a_mechanism():
    made = assemble(joint_chain(CHAIN), [point()], {"tool_z": 0.1, "base_x": 1.0})
    p = {q.name: q.nominal for q in made.parameters}
    x = {"lift": 0.3, "arm": -0.4, "x": 0.0, "y": 0.0, "z": 0.0}
    T = move(x=1.0) @ frame(p, 0.3, -0.4)
    reached = loop_values(made.tape, [x[q] for q in made.tape.quantities], list(p.values()))
    np.testing.assert_allclose(reached, (T @ [0, 0, 0.1, 1])[:3], atol=1e-14)


@pytest.mark.parametrize(
    ("joints", "code", "stated"),
    [
        ([LinkJoint("a", "fixed")], "missing-key", ()),
        ([CHAIN[0], CHAIN[0]], "duplicate-name", ("'lift'",)),
    ],
)
def test_chains_that_are_none_are_refused(joints, code, stated):
    with refused(code, *stated):
        joint_chain(joints)


@pytest.mark.parametrize(
    ("given", "code", "stated"),
    [
        ({"kind": "floating"}, "unknown-name", ("'floating'",)),
        ({"kind": "revolute", "axis": (0, 0, 2)}, "invalid-value", ("2", "'q'")),
        ({"kind": "revolute", "axis": (0, 0, 0)}, "invalid-value", ("'q'",)),
    ],
)
def test_joints_that_are_none_are_refused(given, code, stated):
    with refused(code, *stated):
        LinkJoint("q", **given)
