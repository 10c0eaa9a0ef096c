"""Moving a machine rigidly moves its end point by that motion, for every reading of the joints."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.errors import InputError
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import _along, yaw_pitch_roll
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import Joint, serial_arm
from tests.reference import frames
from tests.reference.machines import MACHINES
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

Array = NDArray[np.float64]
POSES = 50


def reached(machine: Mechanism, joints: Array) -> Array:
    """The points (o, N) that close the loops for joints (k - o, N)."""
    x, row = np.zeros((len(machine.quantities), joints.shape[1])), 0
    for i, quantity in enumerate(machine.tape.quantities):
        if quantity not in machine.outputs:
            x[i] = joints[row]
            row += 1
    p = np.array([parameter.nominal for parameter in machine.parameters])
    # loops are reached minus measured, and measured is zero here
    return loop_values(machine.tape, x, np.broadcast_to(p[:, None], (len(p), joints.shape[1])))


def moved(machine: Mechanism, rotation: Array, shift: Array) -> Mechanism:
    assert machine.placement is not None
    values = {p.name: p.nominal for p in machine.parameters}
    return machine.with_nominal(machine.placement.moved(values, rotation, shift))


def joints_of(machine: Mechanism) -> Array:
    count = len(machine.quantities) - len(machine.outputs)
    return np.random.default_rng(9).uniform(-np.pi, np.pi, (count, POSES))


def worst(machine: Mechanism, rotation: Array, shift: Array) -> float:
    """Largest distance of a moved point from where the moved machine reaches."""
    joints = joints_of(machine)
    expected = rotation @ reached(machine, joints) + shift[:, None]
    return float(abs(reached(moved(machine, rotation, shift), joints) - expected).max())


ANGLES = st.floats(-math.pi, math.pi)
SHIFTS = st.lists(st.floats(-5, 5), min_size=3, max_size=3).map(np.array)
QUATERNIONS = (
    st.lists(st.floats(-1, 1), min_size=4, max_size=4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
)


@given(ANGLES, SHIFTS)
def test_a_planar_arm_moves_exactly(angle: float, shift: Any) -> None:
    c, s = math.cos(angle), math.sin(angle)
    machine = planar_two_link({"xA": 0.3, "phi20": 2.9})
    assert worst(machine, np.array([[c, -s], [s, c]]), shift[:2]) <= 1e-14


@pytest.mark.parametrize("name", ["dh", "mdh", "hayati", "mixed"])
@given(quaternion=QUATERNIONS, shift=SHIFTS)
def test_an_arm_on_a_base_moves_exactly(name: str, quaternion: Any, shift: Any) -> None:
    rotation = Rotation.from_quat(quaternion).as_matrix()
    assert worst(MACHINES[name], rotation, shift) <= 5e-14


def test_on_a_base_only_the_base_changes() -> None:
    machine = MACHINES["dh"]
    turned = moved(machine, Rotation.from_euler("x", 0.3).as_matrix(), np.ones(3))
    changed = {
        p.name
        for p, q in zip(machine.parameters, turned.parameters, strict=True)
        if p.nominal != q.nominal
    }
    assert changed == {f"base_{key}" for key in ("x", "y", "z", "rz", "ry", "rx")}


TRANSITIONS = {
    "MA1400": MACHINES["MA1400"],
    "gantry": MACHINES["gantry"],
    "fixed motions between": serial_arm(
        [
            Joint("q1", "transition-z", before={"rx": 0.2}, after={"tx": 0.3}),
            Joint("q2", "transition-y", direction=-1, after={"ry": 0.4, "tz": 0.1}),
            Joint("q3", "transition-x", before={"rz": -0.3}),
            Joint("q4", "transition-z", kind="prismatic"),
        ],
        {"x1": 0.2, "z2": 0.3, "phiz2": 0.1, "phiy0": 0.2, "x4B": 0.1, "y4B": 0.2, "z4B": 0.3},
    ),
}


@pytest.mark.parametrize("name", TRANSITIONS)
@given(quaternion=QUATERNIONS, shift=SHIFTS)
def test_a_chain_of_transitions_moves_exactly(name: str, quaternion: Any, shift: Any) -> None:
    machine = TRANSITIONS[name]
    rotation = Rotation.from_quat(quaternion).as_matrix()
    try:
        turned = moved(machine, rotation, shift)
    except InputError:
        assume(False)
    # an axis that nearly lies in its plane pierces it far away: digits go with that distance
    reach = max(1.0, *(abs(p.nominal) for p in turned.parameters))
    assume(reach < 1e3)
    # and with the cosine of its turn, where it pierces the plane at the origin
    steep = min(abs(np.cos(p.nominal)) for p in turned.parameters if p.unit == "rad")
    assert worst(machine, rotation, shift) <= 1e-14 * reach**2 + 5e-14 + 1e-15 / steep


@pytest.mark.parametrize("yaw", [math.pi, -math.pi, math.pi - 1e-9, 1e-9 - math.pi, 3.1, -3.1])
@pytest.mark.parametrize("name", ["planar", "dh", "MA1400"])
def test_half_a_turn_about_the_upright_is_nothing_special(name: str, yaw: float) -> None:
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    shift = np.array([1.0, -2.0, 0.5])
    size = len(MACHINES[name].outputs)
    assert worst(MACHINES[name], rotation[:size, :size], shift[:size]) <= 1e-13


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_a_base_turned_upright_where_yaw_and_roll_are_one(pitch: float) -> None:
    machine = MACHINES["dh"].with_nominal({"base_rz": 0.0, "base_ry": 0.0, "base_rx": 0.0})
    rotation = Rotation.from_euler("ZYX", [0.7, pitch, 0.2]).as_matrix()
    assert worst(machine, rotation, np.zeros(3)) <= 1e-13


@given(QUATERNIONS)
def test_yaw_pitch_roll_give_back_the_rotation(quaternion: Any) -> None:
    rotation = Rotation.from_quat(quaternion).as_matrix()
    yaw, pitch, roll = yaw_pitch_roll(rotation)
    again = frames.turn("z", yaw) @ frames.turn("y", pitch) @ frames.turn("x", roll)
    assert again[:3, :3] == pytest.approx(rotation, abs=1e-14)
    assert abs(pitch) <= math.pi / 2


def test_moving_twice_is_moving_by_the_product() -> None:
    rng = np.random.default_rng(10)
    machine = MACHINES["MA1400"]
    first = Rotation.from_euler("xyz", [0.1, -0.2, 2.0]).as_matrix()
    second = Rotation.from_euler("xyz", [-0.3, 0.1, -1.0]).as_matrix()
    a, b = rng.normal(size=3), rng.normal(size=3)
    twice = moved(moved(machine, first, a), second, b)
    once = moved(machine, second @ first, second @ a + b)
    for p, q in zip(twice.parameters, once.parameters, strict=True):
        turns = (p.nominal - q.nominal) / (2 * math.pi) if p.unit == "rad" else 0.0
        assert p.nominal == pytest.approx(q.nominal + 2 * math.pi * round(turns), abs=1e-12)


def test_not_moving_changes_nothing() -> None:
    machine = motoman_ma1400({"phix0": 0.02, "phiz1": -0.3, "phix2": 0.01, "phiy5": 0.04})
    same = moved(machine, np.eye(3), np.zeros(3))
    for p, q in zip(machine.parameters, same.parameters, strict=True):
        assert q.nominal == pytest.approx(p.nominal, abs=1e-14)


def test_an_axis_that_lies_in_the_plane_it_should_pierce_is_refused() -> None:
    machine = MACHINES["MA1400"]
    with refused("unsupported", "'x0'") as caught:
        moved(machine, Rotation.from_euler("x", math.pi / 2).as_matrix(), np.zeros(3))
    assert "'x0'" in str(caught.value)
    assert "before" in str(caught.value)
    quarter = Rotation.from_euler("z", math.pi / 2).as_matrix()
    with refused("unsupported", "'x1'"):
        moved(machine, quarter, np.zeros(3))


def test_a_fixed_motion_ahead_lets_such_a_machine_be_placed() -> None:
    """What the message recommends works: a quarter turn before the first joint."""
    joints = [
        Joint("q1", "transition-z", before={"rz": math.pi / 2}),
        Joint("q2", "transition-y"),
        Joint("q3", "transition-y"),
    ]
    machine = serial_arm(joints, {"z1": 0.4, "z2": 0.5, "x3B": 0.3})
    assert worst(machine, Rotation.from_euler("z", 0.1).as_matrix(), np.ones(3)) <= 1e-13


def test_machines_that_cannot_express_a_rigid_motion_have_no_placement() -> None:
    assert serial_arm([Joint("q")], {}, base=False).placement is None
    assert serial_arm([Joint("q", "transition-z")], {}).placement is None


def test_placement_parameters_are_those_that_say_where_the_machine_stands() -> None:
    names = {name: MACHINES[name].placement for name in ("planar", "dh", "MA1400")}
    assert {n: p.parameters for n, p in names.items() if p} == {
        "planar": ("xA", "yA", "phi20"),
        "dh": ("base_x", "base_y", "base_z", "base_rz", "base_ry", "base_rx"),
        "MA1400": ("x0", "y0", "phix0", "phiy0", "z1", "phiz1"),
    }


def test_the_way_an_axis_turns_is_that_of_the_vector_product() -> None:
    axes = np.eye(3)
    for turn, onto, of in itertools.product("xyz", repeat=3):
        moved = np.cross(axes["xyz".index(turn)], axes["xyz".index(of)])
        assert _along(turn, onto, of) == moved["xyz".index(onto)]
