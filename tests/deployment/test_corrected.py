"""Corrected targets in closed loop against machines of separate code, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses import corrected as loops
from analyses.gauntlet_truth import drawn
from loopcal.companions.robot.arms import arms_of
from loopcal.companions.robot.inverse import solve
from loopcal.companions.robot.rigid import between, tool_of
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.mechanisms.placement import ChainPlacement, rigid
from loopcal.mechanisms.planar import motoman_joints
from loopcal.mechanisms.rotations import rotation_by, rotation_vector
from loopcal.mechanisms.serial import places_itself, serial_machine
from tests.refusals import refused

NAMES = [f"q{i}" for i in range(1, 7)]


@pytest.mark.parametrize("name", loops.ARMS)
def test_a_true_machine_reaches_its_targets_as_surely_as_stated(name: str) -> None:
    found = loops.closed_loop(name, 0, wear=False, poses=60, targets=80)
    floor = np.sqrt(found.variance.mean())
    assert np.sqrt(np.mean(found.before**2)) > 5.0 * floor
    assert np.sqrt(np.mean(found.after**2)) < 1.2 * floor
    assert 0.85 <= found.held.mean() <= 1.0
    assert found.inverse < 1e-9


@pytest.fixture(scope="module")
def sagging() -> lc.Result:
    """A structured six-axis arm, whose calibrated machine sags and has a discrepancy."""
    arm = loops.drawing(loops.ARMS["six-axis"])
    machine = lc.structured(arm, discrepancy=4)
    rng = np.random.default_rng(3)
    truth = {p.name: p.nominal for p in machine.parameters}
    for name in truth:
        unit = machine.parameters[name].unit
        truth[name] += {"m": 3e-4, "rad": 4e-4, "rad/m": 2e-4}[unit] * rng.standard_normal()
    q = drawn(loops.BOXES["six-axis"], 60, rng)
    noise = lc.Noise(dict.fromkeys(NAMES, 3e-5) | dict.fromkeys("xyz", 2e-5))
    made = lc.simulate(
        machine, dict(zip(NAMES, q.T, strict=True)), noise=noise, seed=1, truth=truth
    )
    return lc.calibrate(machine, made.dataset, noise=noise, method="implicit-loop")


def targets(count: int) -> dict[str, np.ndarray]:
    q = drawn(loops.BOXES["six-axis"], count, np.random.default_rng(7))
    return dict(zip(NAMES, q.T, strict=True))


def test_the_machine_that_is_inverted_is_the_one_that_predict_computes(sagging: lc.Result) -> None:
    done = lc.correct(sagging, targets(10))
    assert done.corrected.done.all()
    seen = lc.predict(sagging, done.joints)
    base = done.arms.machine.base
    wanted = (base @ done.corrected.targets.poses)[:, :3, 3]
    reached = np.array([seen.outputs[c] for c in "xyz"]).T
    assert reached == pytest.approx(wanted, abs=1e-9)
    R = base[:3, :3]
    stated = R @ done.corrected.reached.covariance.matrix[:, :3, :3] @ R.T
    assert stated == pytest.approx(seen.covariance, rel=1e-6, abs=1e-6 * seen.covariance.max())


def test_the_controller_maps_a_corrected_pose_to_the_wanted_one(sagging: lc.Result) -> None:
    done = lc.correct(sagging, targets(10))
    start = done.corrected.targets.joints
    q = solve(done.arms.controller, done.poses, start).joints
    assert between(done.arms.machine(q), done.corrected.targets.poses) == pytest.approx(
        np.zeros((10, 6)), abs=1e-9
    )


def test_jacobians_are_differences_of_poses(sagging: lc.Result) -> None:
    arm = lc.correct(sagging, targets(2)).arms.machine
    q = np.array([*targets(5).values()]).T
    names = ("d_4", "tool_x", "q2_sag_z_wrist", "offset_3")
    by_joint, by_parameter = arm.twists(q, names)
    step = 1e-6
    for j in range(6):
        way = step * np.eye(6)[j]
        slope = between(arm(q - way), arm(q + way)) / (2 * step)
        assert by_joint[:, :, j] == pytest.approx(slope, abs=1e-6)  # turns of the body are small
    tape = arm.tape.parameters
    for k, name in enumerate(names):
        way = step * (np.array(tape) == name)
        low, high = (replace(arm, parameters=arm.parameters + s * way) for s in (-1, 1))
        slope = between(low(q), high(q)) / (2 * step)
        assert by_parameter[:, :, k] == pytest.approx(
            slope, abs=1e-6
        )  # turns of the body are small


def reasons(result: lc.Result, q: dict[str, np.ndarray], **options: object) -> list[str | None]:
    done = lc.correct(result, q, **options)  # type: ignore[arg-type]
    kept: list[str | None] = [None if r is None else r.reason for r in done.corrected.refused]
    untouched = [r is not None for r in done.corrected.refused]
    assert np.isnan(done.u95).tolist() == untouched
    return kept


def test_targets_are_refused_by_name(sagging: lc.Result) -> None:
    q = targets(3)
    q["q5"][1] = 1e-3  # the wrist stretched
    assert reasons(sagging, q) == [None, "singular", None]
    bounds = lc.CorrectionBounds(turn=1e-6)
    assert reasons(sagging, targets(2), bounds=bounds) == ["moved-too-far"] * 2
    q["q3"][2] = -1.9  # behind the shoulder, where nothing is singular yet everything is known
    assert "U95" in str(lc.correct(sagging, q))


def test_targets_outside_limits_are_refused() -> None:
    found = lc.correct(_limited(), {"j1": [0.2, 0.49999], "j2": [0.3, 0.3], "j3": [0.4, 0.4]})
    assert [r and r.reason for r in found.corrected.refused] == [None, "outside-limits"]


def _limited() -> lc.Result:
    from loopcal.mechanisms.origins import LinkJoint, joint_chain

    chain = [
        LinkJoint("j1", "revolute", (0.0, 0.0, 0.3), axis=(0.0, 0.0, 1.0), limits=(-0.5, 0.5)),
        LinkJoint("j2", "revolute", (0.1, 0.0, 0.1), axis=(0.0, 1.0, 0.0)),
        LinkJoint("j3", "revolute", (0.4, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
    ]
    arm = lc.assemble(
        joint_chain(chain),
        [lc.instruments.point(station=None)],
        {"tool_x": 0.3, "tool_z": 0.05},
    )
    arm = lc.fix_redundant(arm)
    q = lc.random_poses({f"j{i}": (-0.5, 1.0) for i in (1, 2, 3)}, 30, seed=1)
    truth = {n: p.nominal for n, p in ((p.name, p) for p in arm.parameters)}
    free = [n for n in arm.parameters.free if arm.parameters[n].unit == "rad"]
    truth |= {n: truth[n] - 1e-3 for n in free}
    noise = lc.Noise({"j*": 1e-5, "?": 1e-5})
    made = lc.simulate(arm, q, noise=noise, seed=2, truth=truth)
    return lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")


def test_a_stated_tool_turns_with_the_last_link(sagging: lc.Result) -> None:
    q = targets(4)
    plain = lc.correct(sagging, q, tool=[0, 0, 0]).arms
    seated = lc.correct(sagging, q, tool=[10, 20, 30, 0, 90, 0]).arms
    joints = np.array([*q.values()]).T
    mount = np.eye(4)
    mount[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    mount[:3, 3] = 0.01, 0.02, 0.03
    for one, other in ((plain.machine, seated.machine), (plain.controller, seated.controller)):
        assert one(joints) @ mount == pytest.approx(other(joints), abs=1e-6)


def test_what_cannot_be_corrected_is_refused_whole(sagging: lc.Result) -> None:
    with refused("unknown-name", "'flange'"):
        lc.correct(sagging, targets(1), tool="flange")
    with refused("missing-reading", "'q6'"):
        lc.correct(sagging, {q: v for q, v in targets(1).items() if q != "q6"})
    with refused("unknown-name", "temperature"):
        lc.correct(sagging, targets(1), at={"temperature": 300.0})
    planar = lc.planar_two_link({"l2": 0.8, "l3": 0.6})
    with refused("unknown-name", "q1"):
        lc.correct(sagging, targets(1), controller=loops.drawing(loops.ARMS["SCARA"]))
    made = lc.simulate(
        planar,
        lc.grid_poses({"phi2": (-1.0, 1.0, 5), "phi3": (0.5, 2.0, 5)}),
        noise={"*": 1e-4},
        seed=1,
    )
    result = lc.calibrate(planar, made.dataset, noise={"*": 1e-4}, method="least-squares")
    with refused("unsupported", "not a serial arm"):
        lc.correct(result, {"phi2": [0.1], "phi3": [1.0]})


def test_a_temperature_is_stated_and_not_in_degrees_taken_as_kelvin() -> None:
    arm = lc.with_effects(loops.drawing(loops.ARMS["six-axis"]), [lc.effects.Thermal()])
    nominal = {p.name: p.nominal for p in arm.parameters} | {"thermal_expansion": 12e-6}
    warm = arm.with_nominal(nominal)
    tool = tool_of(warm, nominal)
    at = {"temperature": 303.15}
    q = np.array([*targets(3).values()]).T
    grown = arms_of(warm, nominal, tool, at=at).machine(q)[:, :3, 3]
    drawn = arms_of(warm, nominal, tool, at={"temperature": 293.15}).machine(q)[:, :3, 3]
    assert np.linalg.norm(grown - drawn, axis=1) == pytest.approx(
        120e-6 * np.linalg.norm(drawn, axis=1), rel=0.2
    )
    with refused("missing-reading", "temperature") as caught:
        arms_of(warm, nominal, tool)
    assert caught.value.options == ("--at", "temperature=22 degC")
    with refused("implausible-unit", "30 K") as caught:
        arms_of(warm, nominal, tool, at={"temperature": 30.0})
    assert caught.value.options == ("--at", "temperature=30 degC")


def test_an_arm_whose_own_parameters_place_it_is_based_where_its_drawing_fits_best() -> None:
    arm = lc.motoman_ma1400()
    names = [f"theta_{i}" for i in range(1, 7)]
    q = lc.random_poses(dict.fromkeys(names, (-0.8, 0.8)), 60, seed=1)
    truth = {p.name: p.nominal for p in arm.parameters}
    assert arm.placement is not None
    turn = rotation_by(np.array([0.02, -0.03, 0.4]))
    truth = arm.placement.moved(truth, turn, np.array([0.4, -0.2, 0.3]))  # where it stands
    truth |= {n: truth[n] + 8e-4 for n in ("phix3", "phiz2", "x4", "z3") if n in truth}
    noise = lc.Noise({"theta_*": 2e-5, **dict.fromkeys("xyz", 2e-5)})
    made = lc.simulate(arm, q, noise=noise, seed=2, truth=truth)
    result = lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")
    wanted = lc.random_poses(dict.fromkeys(names, (0.2, 0.7)), 5, seed=3)
    done = lc.correct(result, wanted)
    assert done.corrected.done.all(), str(done)
    assert np.linalg.norm(done.corrected.before[:, :3], axis=1).max() < 5e-3
    seen = lc.predict(result, done.joints)
    base = done.arms.machine.base
    aim = (base @ done.corrected.targets.poses)[:, :3, 3]
    reached = np.array([seen.outputs[c] for c in "xyz"]).T
    assert reached == pytest.approx(aim, abs=1e-9)


def test_a_measured_pose_says_how_the_tool_is_rotation_by() -> None:
    arm = loops.drawing(loops.ARMS["six-axis"])
    assert arm.description is not None
    seen = lc.assemble(serial_machine(arm.description["joints"]), [lc.instruments.pose("camera")])
    drawn_at = {p.name: p.nominal for p in arm.parameters if p.name in seen.parameters.names}
    seen = seen.with_nominal(drawn_at | {"tool_rz": 0.3, "tool_ry": -0.2})
    truth = {p.name: p.nominal + 3e-4 for p in seen.parameters}
    q = drawn(loops.BOXES["six-axis"], 40, np.random.default_rng(1))
    noise = lc.Noise(dict.fromkeys(seen.quantities, 2e-5))
    joints = dict(zip(NAMES, q.T, strict=True))
    made = lc.simulate(seen, joints, noise=noise, seed=1, truth=truth)
    result = lc.calibrate(
        seen, made.dataset, noise=noise, prior=loops.prior(seen), method="implicit-loop"
    )
    done = lc.correct(result, targets(6))
    assert done.corrected.done.all()
    assert "was not measured" not in str(done)
    reached = done.corrected.reached
    assert reached.radial(3).max() < 3e-4  # far below the prior of the last link's turn, 2 mrad
    machine = seen.with_nominal(truth)
    again = lc.simulate(machine, done.joints, noise={"*": 0.0}, seed=1).dataset
    q = np.array([again[c] for c in ("qx", "qy", "qz", "qw")]).T
    R = Rotation.from_quat(q).as_matrix()
    wanted = done.arms.machine.base @ done.corrected.targets.poses
    off = np.linalg.norm(rotation_vector(np.swapaxes(R, 1, 2) @ wanted[:, :3, :3]), axis=1)
    assert (off < 2.0 * reached.radial(3)).all()


def test_an_arm_that_its_own_transitions_place_sags_as_it_was_calibrated() -> None:
    """Also where its reflector slipped along the run: the tool is where it was afterwards."""
    slipped = {"type": "shift", "changing": ["x6B"], "at": [10.0], "column": "pose number"}
    data = {
        "type": "motoman-ma1400",
        "effect": [slipped | {"unit": "1", "name": "slip"}],
        "structure": {"discrepancy": 4},
    }
    arm = mechanism_from_data(data, "a file")
    rng = np.random.default_rng(2)
    own = [n for n in arm.parameters.names if "sag" in n or "discrepancy" in n or "_from" in n]
    assert len(own) > 20
    values = {p.name: p.nominal for p in arm.parameters}
    arm = arm.with_nominal({n: values[n] + 1e-3 * rng.standard_normal() for n in own})
    arms = arms_of(arm, values, tool_of(arm, values))
    q = rng.uniform(-1.0, 1.0, (20, 6))
    joints = dict(zip(arms.joints, q.T, strict=True))
    made = lc.simulate(arm, joints | {"pose number": np.full(20, 11.0)}, noise={"*": 0.0}, seed=0)
    seen = np.array([made.dataset[axis] for axis in "xyz"]).T
    reached = (arms.machine.base @ arms.machine(q))[:, :3, 3]
    assert reached == pytest.approx(seen, abs=1e-9)
    now = values["x6B"] + next(arm.parameters[n].nominal for n in own if n.startswith("x6B_from"))
    assert arms.tool.of_controller[0] == pytest.approx(now, abs=1e-12)
    nominal = arms_of(arm, values, tool_of(arm, values, "nominal")).tool
    assert nominal.of_machine[0] == pytest.approx(now, abs=1e-12)
    assert nominal.of_controller[0] == values["x6B"]


def test_transitions_seen_by_two_instruments_without_station_find_their_base() -> None:
    """Where the whole machine was seen elsewhere, its controller still has it in its own base."""
    single = mechanism_from_data({"type": "motoman-ma1400"}, "a file")
    drawn = {p.name: p.nominal for p in single.parameters}
    T = rigid(rotation_by(np.array([0.1, -0.2, 0.7])), np.array([1.0, 2.0, 0.3]))
    assert isinstance(single.placement, ChainPlacement)
    placed = single.placement.moved(drawn, T[:3, :3], T[:3, 3])
    joints = [{"name": j.name, "form": j.form, "direction": j.direction} for j in motoman_joints()]
    second = {"name": "second", "readings": ["x_2", "y_2", "z_2"], "target": ["a_x", "a_y", "a_z"]}
    first = {"readings": ["x", "y", "z"], "target": ["x6B", "y6B", "z6B"]}
    seen = [{"type": "point", "station": False, **one} for one in (first, second)]
    data = {"type": "serial", "joint": joints, "fix_redundant": False, "instrument": seen}
    arm = mechanism_from_data(data, "two").with_nominal(placed)
    assert places_itself(arm)
    values = {p.name: p.nominal for p in arm.parameters} | drawn
    arms = arms_of(arm, values, tool_of(arm, values), home=dict.fromkeys(single.quantities, 0.2))
    assert arms.machine.base == pytest.approx(T, abs=1e-9)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
    assert arms.machine(q) == pytest.approx(arms.controller(q), abs=1e-9)


def test_conditions_that_the_calibration_did_not_see_are_remarked() -> None:
    arm = lc.with_effects(loops.drawing(loops.ARMS["six-axis"]), [lc.effects.Thermal()])
    rng = np.random.default_rng(3)
    q = dict(zip(NAMES, drawn(loops.BOXES["six-axis"], 40, rng).T, strict=True))
    noise = lc.Noise(dict.fromkeys(NAMES, 3e-5) | dict.fromkeys("xyz", 2e-5))
    read = lc.simulate(arm, q | {"temperature": rng.uniform(293.0, 299.0, 40)}, noise=noise, seed=1)
    result = lc.calibrate(arm, read.dataset, noise=noise, method="implicit-loop")
    for celsius, remarked in ((26.0, False), (40.0, True)):
        done = lc.correct(result, targets(2), at={"temperature": 273.15 + celsius})
        assert ("temperature reaches 40 degC" in done.words()) is remarked
