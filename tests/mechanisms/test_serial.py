"""Serial arms against matrices written out by hand and against programs of others."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.errors import Code
from loopcal.mechanisms.chain import Step, apply, matrix, product
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, chain_steps, serial_arm
from tests.reference import frames
from tests.reference.machines import BASE, DIRECTIONS, SIX, TOOL, dh_arm, mixed_arm
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

Array = NDArray[np.float64]


def reached(arm: Mechanism, joints: Mapping[str, float]) -> Array:
    """The measured point that closes the loops."""
    x = [joints.get(q, 0.0) for q in arm.tape.quantities]
    p = [parameter.nominal for parameter in arm.parameters]
    point: Array = loop_values(arm.tape, x, p)
    return point


def random_joints(names: Any, count: int = 100) -> list[dict[str, float]]:
    rng = np.random.default_rng(5)
    return [
        dict(zip(names, row.tolist(), strict=True))
        for row in rng.uniform(-pi, pi, (count, len(names)))
    ]


def base_frame() -> Array:
    T: Array = (
        frames.move(BASE["base_x"], BASE["base_y"], BASE["base_z"])
        @ frames.turn("z", BASE["base_rz"])
        @ frames.turn("y", BASE["base_ry"])
        @ frames.turn("x", BASE["base_rx"])
    )
    return T


@pytest.mark.parametrize("form", ["dh", "mdh", "hayati"])
def test_a_six_axis_arm_of_each_convention_equals_its_matrices(form: str) -> None:
    arm = dh_arm(form)
    matrix = {"dh": frames.dh, "mdh": frames.modified_dh, "hayati": frames.hayati}[form]
    for joints in random_joints([f"q{i}" for i in range(1, 7)]):
        T = base_frame()
        for row, q, direction in zip(SIX, joints.values(), DIRECTIONS, strict=True):
            a, b, c, offset = row
            T = T @ matrix(a, b, c, offset + direction * q)
        assert reached(arm, joints) == pytest.approx(
            frames.point_of(T, list(TOOL.values())), abs=1e-14
        )


@pytest.mark.parametrize("axis", "xyz")
def test_a_transition_moves_in_its_plane_turns_about_it_then_by_the_joint(axis: str) -> None:
    first, second = {"z": ("x", "y"), "y": ("x", "z"), "x": ("y", "z")}[axis]
    numbers = (0.3, -0.2, 0.4, -0.7)
    names = (f"{first}0", f"{second}0", f"phi{first}0", f"phi{second}0")
    arm = serial_arm(
        [Joint("q", f"transition-{axis}", direction=-1)],
        {**dict(zip(names, numbers, strict=True)), "x1B": 0.1, "y1B": 0.2, "z1B": 0.3},
    )
    assert arm.parameters.names == (*names, "x1B", "y1B", "z1B")
    for joints in random_joints(["q"]):
        T = frames.transition(axis, numbers, frames.turn(axis, -joints["q"]))
        assert reached(arm, joints) == pytest.approx(frames.point_of(T, [0.1, 0.2, 0.3]), abs=1e-15)


def test_all_conventions_kinds_and_fixed_motions_in_one_arm() -> None:
    arm = mixed_arm()
    p = {parameter.name: parameter.nominal for parameter in arm.parameters}
    for q in random_joints([f"q{i}" for i in range(1, 8)]):
        T = base_frame()
        T = T @ frames.turn("x", 0.3) @ frames.move(z=0.2)
        T = T @ frames.dh(p["a_1"], p["d_1"], p["alpha_1"], p["offset_1"] + q["q1"])
        T = T @ frames.hayati(p["a_2"], p["alpha_2"], p["beta_2"], p["offset_2"] - q["q2"])
        T = T @ frames.move(y=0.1)
        T = T @ frames.dh(p["a_3"], p["d_3"] + q["q3"], p["alpha_3"], p["offset_3"])
        T = T @ frames.modified_dh(p["a_4"], p["d_4"] - q["q4"], p["alpha_4"], p["offset_4"])
        T = T @ frames.transition(
            "y", [p["x4"], p["z4"], p["phix4"], p["phiz4"]], frames.turn("y", q["q5"])
        )
        T = T @ frames.turn("z", 0.4) @ frames.move(x=-0.1)
        T = T @ frames.turn("z", p["offset_6"]) @ frames.move(z=q["q6"]) @ frames.move(x=p["a_6"])
        T = T @ frames.turn("x", p["alpha_6"]) @ frames.turn("y", p["beta_6"])
        T = T @ frames.turn("y", 0.2)
        T = T @ frames.transition(
            "x", [p["y6"], p["z6"], p["phiy6"], p["phiz6"]], frames.move(x=q["q7"])
        )
        assert reached(arm, q) == pytest.approx(frames.point_of(T, list(TOOL.values())), abs=1e-13)


def test_the_chain_of_steps_gives_the_whole_frame_too() -> None:
    joints = [Joint("q1", "dh"), Joint("q2", "mdh", direction=-1)]
    p = {"a_1": 0.3, "d_1": 0.1, "alpha_1": 0.2, "offset_1": 0.4}
    p |= {"a_2": 0.5, "d_2": -0.1, "alpha_2": 0.6, "offset_2": -0.3}
    T = product(chain_steps(joints), {"q1": 0.7, "q2": 0.9}, p)
    expected = frames.dh(0.3, 0.1, 0.2, 1.1) @ frames.modified_dh(0.5, -0.1, 0.6, -1.2)
    assert pytest.approx(expected, abs=1e-15) == T


@pytest.mark.parametrize("motion", ["tx", "ty", "tz", "rx", "ry", "rz"])
def test_the_matrix_of_a_step_moves_points_as_the_step_does(motion: str) -> None:
    step, point = Step(motion, "amount"), np.array([0.3, -0.2, 0.7])
    moved = matrix(step, 0.4) @ [*point, 1.0]
    assert moved[:3] == pytest.approx(apply([step], point, {}, {"amount": 0.4}), abs=1e-15)


def test_pytransform3d_reaches_the_same_point() -> None:
    rotations = pytest.importorskip("pytransform3d.rotations", reason="make partners")
    transformations = pytest.importorskip("pytransform3d.transformations", reason="make partners")

    def turn(axis: int, angle: float) -> Any:
        R = rotations.active_matrix_from_angle(axis, angle)
        return transformations.transform_from(R, np.zeros(3))

    def move(*shift: float) -> Any:
        return transformations.transform_from(np.eye(3), np.array(shift))

    arm = dh_arm("dh")
    for joints in random_joints([f"q{i}" for i in range(1, 7)], 20):
        yaw_pitch_roll = [BASE["base_rz"], BASE["base_ry"], BASE["base_rx"]]
        euler = rotations.matrix_from_euler(yaw_pitch_roll, 2, 1, 0, extrinsic=False)
        place = [BASE["base_x"], BASE["base_y"], BASE["base_z"]]
        T = transformations.transform_from(euler, place)
        for (a, d, alpha, offset), q, sign in zip(SIX, joints.values(), DIRECTIONS, strict=True):
            for part in (turn(2, offset + sign * q), move(0, 0, d), move(a, 0, 0), turn(0, alpha)):
                T = T @ part
        expected = transformations.transform(T, np.append(list(TOOL.values()), 1.0))[:3]
        assert reached(arm, joints) == pytest.approx(expected, abs=1e-14)


def test_pinocchio_reaches_the_same_point() -> None:
    pin = pytest.importorskip("pinocchio", reason="make partners")

    def place(T: Array) -> Any:
        return pin.SE3(T[:3, :3], T[:3, 3])

    arm = dh_arm("dh")
    model, parent, ahead = pin.Model(), 0, base_frame()
    for i, ((a, d, alpha, offset), direction) in enumerate(zip(SIX, DIRECTIONS, strict=True)):
        # Rz(offset + q) Tz(d) Tx(a) Rx(alpha): the joint turns behind its offset
        axis = np.array([0.0, 0.0, float(direction)])
        placed = place(ahead @ frames.turn("z", offset))
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(axis), placed, f"q{i}")
        ahead = frames.move(a, 0.0, d) @ frames.turn("x", alpha)
    data = model.createData()
    for joints in random_joints([f"q{i}" for i in range(1, 7)], 20):
        pin.forwardKinematics(model, data, np.array(list(joints.values())))
        tip = data.oMi[6].act(frames.point_of(ahead, list(TOOL.values())))
        assert reached(arm, joints) == pytest.approx(tip, abs=1e-14)


def test_what_is_not_given_is_zero_and_what_is_given_keeps_prior_and_fixed() -> None:
    arm = serial_arm(
        [Joint("q")], {"a_1": 0.5, "d_1": Parameter("d_1", 0.2, "m", prior_sd=1e-3, fixed=True)}
    )
    assert arm.parameters["a_1"].nominal == 0.5
    assert arm.parameters["alpha_1"].nominal == 0.0
    assert arm.parameters["d_1"].fixed
    assert arm.parameters["d_1"].prior_sd == 1e-3


def test_units_follow_from_the_motions() -> None:
    arm = mixed_arm()
    assert arm.quantities["q1"] == "rad"
    assert arm.quantities["q3"] == "m"
    assert arm.quantities["x"] == "m"
    units = {p.name: p.unit for p in arm.parameters}
    assert units["a_2"] == units["d_3"] == units["x4"] == units["base_x"] == units["tool_z"] == "m"
    assert units["alpha_2"] == units["beta_2"] == units["phix4"] == units["base_rx"] == "rad"


def test_an_arm_has_a_base_unless_all_joints_are_transitions() -> None:
    transitions = serial_arm([Joint("q", "transition-z")], {})
    assert not any(name.startswith("base_") for name in transitions.parameters.names)
    assert serial_arm([Joint("q")], {}).parameters.names[:6] == tuple(BASE)
    assert "base_x" not in serial_arm([Joint("q")], {}, base=False).parameters.names
    assert "base_x" in serial_arm([Joint("q", "transition-z")], {}, base=True).parameters.names


def test_the_point_may_have_other_names() -> None:
    arm = serial_arm([Joint("q")], {}, point=("X", "Y", "Z"))
    assert arm.outputs == arm.tape.loops == ("X", "Y", "Z")


@pytest.mark.parametrize(
    ("make", "code", "stated"),
    [
        (lambda: Joint("q", "mhd"), "unknown-name", ("'mhd'", "'mdh'")),
        (
            lambda: Joint("q", kind="linear"),
            "unknown-name",
            ("'linear'", "'revolute'", "'prismatic'"),
        ),
        (lambda: Joint("q", direction=0), "invalid-value", ("0", "1", "-1", "'q'")),
        (lambda: Joint("q", before={"rw": 0.1}), "unknown-name", ("'rw'", "'rx'", "'ry'", "'rz'")),
        (lambda: serial_arm([], {}), "missing-key", ()),
        (lambda: serial_arm([Joint("q")], {"a1": 0.1}), "unknown-name", ("'a1'", "'a_1'")),
        (lambda: serial_arm([Joint("q"), Joint("q")], {}), "duplicate-name", ("'q'",)),
        (lambda: serial_arm([Joint("x")], {}), "duplicate-name", ("'x'",)),
    ],
)
def test_what_cannot_be_an_arm_is_named(make: Any, code: Code, stated: tuple[str, ...]) -> None:
    with refused(code, *stated):
        make()
