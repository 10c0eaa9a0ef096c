"""Rest transforms, Denavit-Hartenberg tables and calibrated origins: the same kinematics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.files.exports.tables import dh_table, modified
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.origins import LinkJoint, Mimic, calibrated_origins, joint_chain
from loopcal.mechanisms.rest import (
    RestChain,
    RestJoint,
    quaternion,
    rest_chain,
    roll_pitch_yaw,
    rotation,
)
from tests.reference.dh_arm import table_pose

QUARTER = 0.5 * math.pi


def random_arm(rng: np.random.Generator, joints: int = 6) -> tuple[LinkJoint, ...]:
    """Joints of every kind, with axes in any direction, one of which mimics another."""
    made = []
    for i in range(joints):
        axis = np.eye(3)[i % 3] if i % 2 else rng.normal(size=3)
        x, y, z = axis / np.linalg.norm(axis) * rng.choice([-1.0, 1.0])
        kind = (
            ("revolute", "continuous", "prismatic", "fixed")[rng.integers(4)] if i else "revolute"
        )
        mimic = Mimic("q0", -2.0, 0.3) if i == 3 and kind != "fixed" else None
        place = tuple(rng.uniform(-1, 1, 3)), tuple(rng.uniform(-3, 3, 3))
        made.append(LinkJoint(f"q{i}", kind, *place, (x, y, z), mimic=mimic))
    return tuple(made)


def perturbed(machine, rng):
    return {n: p.nominal + 1e-2 * rng.normal() for n, p in machine.parameters.items()}


@pytest.mark.parametrize("seed", range(10))
def test_rest_transforms_and_both_tables_reach_what_the_steps_reach(seed):
    rng = np.random.default_rng(seed)
    machine = joint_chain(random_arm(rng))
    values = perturbed(machine, rng)
    chain = rest_chain(machine.chain, values)
    table = dh_table(chain)
    q = {n: rng.uniform(-3, 3) for n in machine.quantities}
    expected = product(machine.chain, q, values)
    for found in (
        chain.pose(q),
        chain.along_z.pose(q),
        table_pose(table, q),
        table_pose(modified(table), q, modified=True),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 1e-11, 1e-8, 1e-6, 1e-4, 1e-2, math.pi])
def test_nearly_parallel_axes_keep_their_kinematics_in_a_table(tilt):
    steps = (
        Step("rz", joint="a"), Step("tx", constant=0.4), Step("ty", constant=0.1),
        Step("rx", constant=tilt), Step("rz", joint="b"), Step("tx", constant=0.3),
    )  # fmt: skip
    table = dh_table(rest_chain(steps, {}))
    q = {"a": 0.7, "b": -1.1}
    # at 1e-8 rad the common normal is 10,000 km away, where doubles are 2 nm apart
    np.testing.assert_allclose(table_pose(table, q), product(steps, q, {}), atol=2e-9)


def test_the_table_of_an_arm_drawn_by_a_table_is_that_table():
    """a, d, alpha and theta of a UR5e, whose a is negative by its makers' convention."""
    rows = [
        (0.0, 0.1625, QUARTER), (-0.425, 0.0, 0.0), (-0.3922, 0.0, 0.0),
        (0.0, 0.1333, QUARTER), (0.0, 0.0997, -QUARTER), (0.0, 0.0996, 0.0),
    ]  # fmt: skip
    steps = [
        step
        for i, (a, d, alpha) in enumerate(rows)
        for step in (
            Step("rz", joint=f"q{i}"), Step("tz", constant=d),
            Step("tx", constant=a), Step("rx", constant=alpha),
        )
    ]  # fmt: skip
    table = dh_table(rest_chain(steps, {}))
    for row, (a, d, alpha) in zip(table.rows[:3], rows, strict=False):
        np.testing.assert_allclose(
            (row.a, row.d, row.alpha, row.theta), (a, d, alpha, 0.0), atol=1e-15
        )


def test_quaternions_are_those_of_scipy():
    rng = np.random.default_rng(1)
    turns = [*Rotation.random(50, random_state=1), *Rotation.from_rotvec(np.pi * np.eye(3))]
    turns += [Rotation.from_rotvec(v) for v in rng.normal(size=(9, 3)) * 1e-9]
    for turn in turns:
        q = np.array(quaternion(turn.as_matrix()))
        back = Rotation.from_quat(q, scalar_first=True)
        np.testing.assert_allclose(back.as_matrix(), turn.as_matrix(), atol=1e-15)
        assert q[0] >= 0.0


@pytest.mark.parametrize("pitch", [0.3, -2.5, QUARTER, -QUARTER, QUARTER - 1e-9, 1.57079632679])
def test_of_equivalent_rpy_the_nearest_to_the_old_is_taken(pitch):
    """The old triple itself comes back, also half a turn away and where roll and yaw are one."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        old = np.array([rng.uniform(-6, 6), pitch, rng.uniform(-6, 6)])
        R = Rotation.from_euler("xyz", old).as_matrix()  # about fixed axes: Rz Ry Rx
        found = roll_pitch_yaw(R, old.tolist())
        np.testing.assert_allclose(Rotation.from_euler("xyz", found).as_matrix(), R, atol=1e-15 * 4)
        if abs(abs(pitch) - QUARTER) > 1e-8:
            np.testing.assert_allclose(found, old, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_offsets_stand_in_the_origin_or_apart_never_in_both(seed):
    """T(q) with whole origins is T(q + offsets) with the others."""
    rng = np.random.default_rng(seed)
    joints = random_arm(rng)
    machine = joint_chain(joints)
    values = perturbed(machine, rng)
    q = {n: rng.uniform(-2, 2) for n in machine.quantities}
    expected = product(machine.chain, q, values)
    for apart in (False, True):
        found = calibrated_origins(joints, values, axes=False, apart=apart)
        offsets = {one.joint.name: one.offset for one in found}
        assert any(offsets.values()) == apart
        T = np.eye(4)
        for one in found:
            T = T @ one.T @ moved(one, q, offsets)
        np.testing.assert_allclose(T, expected, atol=1e-12)


def moved(one, q, offsets):
    joint = one.joint
    if joint.reads is None:
        return np.eye(4)
    follows = joint.mimic or Mimic(joint.name)
    amount = follows.multiplier * (q[follows.joint] + offsets[follows.joint]) + follows.offset
    kind = "prismatic" if joint.kind == "prismatic" else "revolute"
    x, y, z = one.along
    return RestJoint("", "q", kind, (x, y, z), 1.0, np.eye(4)).motion(amount)


def test_an_offset_is_all_that_a_wrong_zero_changes():
    """A joint turned about its own axis alone leaves its origin as drawn."""
    joint = LinkJoint("j", "revolute", (0.1, 0.2, 0.3), (0.3, 0.2, 0.1), (0.0, 0.0, 1.0))
    values = {p.name: p.nominal for p in joint.origin} | {"j_rz": 0.01}
    (found,) = calibrated_origins([joint], values, axes=False, apart=True)
    assert found.offset == pytest.approx(0.01, abs=1e-15)
    np.testing.assert_allclose(found.T, found.drawn, atol=1e-15)


def test_a_tilted_axis_is_the_axis_of_the_steps():
    joint = LinkJoint("j", "revolute", axis=(0.6, 0.0, 0.8))
    machine = joint_chain([joint], axes=True)
    rng = np.random.default_rng(3)
    values = perturbed(machine, rng)
    (found,) = calibrated_origins([joint], values, axes=True, apart=False)
    q = 0.9
    turned = np.eye(4)
    turned[:3, :3] = rotation(found.axis, q)
    np.testing.assert_allclose(
        found.T @ turned, product(machine.chain, {"j": q}, values), atol=1e-14
    )


def test_a_chain_without_fixed_parts_is_its_joints():
    chain = RestChain(
        (RestJoint("a", "a", "prismatic", (0.0, 1.0, 0.0), -1.0, np.eye(4)),), np.eye(4)
    )
    np.testing.assert_allclose(chain.pose({"a": 0.2})[:3, 3], (0.0, -0.2, 0.0))
