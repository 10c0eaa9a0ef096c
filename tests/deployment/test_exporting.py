"""What is exported of a calibration: the geometry, its cost, and zeros, tool and base alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.robot import correct_files, export_files, exporting
from loopcal.companions.robot.exporting import exported
from loopcal.companions.robot.refit import Goal, refit, seen_points, separable, traced
from loopcal.files.project.project_data import computed_joints
from loopcal.mechanisms.chain import product
from loopcal.statistics.predictor import predictor
from tests.refusals import refused

QUARTER = 0.5 * np.pi
FORMS = ("dh", "hayati", "dh", "dh", "dh", "dh")
NOMINAL = {
    "d_1": 0.45, "a_1": 0.15, "alpha_1": -QUARTER, "offset_2": -QUARTER, "a_2": 0.6,
    "a_3": 0.12, "alpha_3": -QUARTER, "d_4": 0.64, "alpha_4": QUARTER, "alpha_5": -QUARTER,
    "tool_x": 0.05, "tool_z": 0.18,
}  # fmt: skip
JOINTS = [f"q{i}" for i in range(1, 7)]
RANGES = dict.fromkeys(JOINTS, (-1.2, 1.2))
NOISE = lc.Noise({"q*": 2e-5, **dict.fromkeys("xyz", 2e-5)})
PLACED = {"base_x": 1.5, "base_y": 0.4, "base_rz": 0.5}
ZEROS = {"offset_2": 2e-3, "offset_3": -1.5e-3, "offset_4": 1e-3, "offset_5": 3e-3}


def arm() -> lc.Mechanism:
    joints = [lc.Joint(q, form) for q, form in zip(JOINTS, FORMS, strict=True)]
    return lc.fix_redundant(lc.serial_arm(joints, NOMINAL))


def bent(mechanism: lc.Mechanism) -> lc.Mechanism:
    load = lc.effects.Load("tip", "q6", (0.0, 0.0, 0.1))
    return lc.with_effects(mechanism, [lc.effects.Compliance((load,), yielding=("q2", "q3"))])


def calibrated(mechanism: lc.Mechanism, truth: dict[str, float], seed: int = 1) -> lc.Result:
    poses = lc.random_poses(RANGES, 60, seed=seed)
    wrong = {p.name: p.nominal for p in mechanism.parameters} | PLACED
    wrong |= {n: wrong[n] + v for n, v in truth.items()}
    made = lc.simulate(mechanism, poses, noise=NOISE, seed=seed, truth=wrong)
    return lc.calibrate(mechanism, made.dataset, noise=NOISE, method="implicit-loop")


@pytest.fixture(scope="module")
def rigid() -> lc.Result:
    """An arm that differs from its drawing by its zeros and its tool alone."""
    return calibrated(arm(), ZEROS | {"tool_x": 1e-3})


@pytest.fixture(scope="module")
def sagging() -> lc.Result:
    return calibrated(bent(arm()), ZEROS | {"q2_sag_tip": 1e-3, "q3_sag_tip": 8e-4, "a_2": 1e-3})


def of(result: lc.Result):
    return exported(result.unjudged, result.calibrated, result.dataset, predictor(result))


def test_zeros_alone_are_worth_everything_where_only_zeros_are_wrong(rigid):
    machine = of(rigid)
    full, zeros = machine.of("full"), machine.of("zeros and tool")
    assert zeros.measured.rms == pytest.approx(full.measured.rms, rel=0.1)
    found = {zero.joint: zero for zero in machine.zeros}
    assert [q for q, zero in found.items() if not zero.determined] == ["q1", "q6"]
    for name, true in ZEROS.items():
        zero = found[f"q{name[-1]}"]
        assert abs(zero.offset - true) < 2.0 * zero.u95


def test_zeros_of_joints_that_the_controller_counts_otherwise_are_warned_of(rigid, monkeypatch):
    columns = {"q4": {"column": "-J4"}, "q5": {"column": "joint-5"}}
    assert computed_joints({"data": {"source": {"columns": columns}}}) == ("q4 as -J4",)
    for module in (correct_files, export_files):
        monkeypatch.setattr(module, "computed_joints", lambda inputs: ("q4 as -J4",))
    assert any("q4 as -J4" in words for words in lc.export(rigid, to="zeros").warnings)
    assert not any("q4 as -J4" in words for words in lc.export(rigid, to="dh").warnings)
    with refused("unsupported", "q4 as -J4", "direction"):
        lc.correct(rigid, "program.src")


def test_zeros_that_make_an_arm_worse_are_warned_of(rigid, monkeypatch):
    machine = of(rigid)
    assert not any("worse" in words for words in lc.export(rigid, to="zeros").warnings)
    zeros, nominal = machine.of("zeros and tool"), machine.of("nominal")
    swapped = (replace(zeros, model="nominal"), replace(nominal, model="zeros and tool"))
    worse = replace(machine, accuracy=(*swapped, *machine.accuracy[2:]))
    monkeypatch.setattr("loopcal.companions.robot.export_files.exported", lambda *_, **__: worse)
    assert any("worse at the measured poses" in w for w in lc.export(rigid, to="zeros").warnings)
    assert not any("worse" in words for words in lc.export(rigid, to="dh").warnings)


def test_the_exported_geometry_of_a_rigid_arm_is_the_calibrated_one(rigid):
    machine = of(rigid)
    values = {p.name: p.value for p in rigid.document.parameters}
    assert dict(machine.values) == values
    assert machine.of("geometry").from_full.max < 1e-12
    assert machine.of("geometry").measured.rms == pytest.approx(rigid.document.accuracy.after.rms)
    q = dict.fromkeys(JOINTS, 0.4)
    T = product(rigid.calibrated.chain, q, values)
    np.testing.assert_allclose(machine.chain.pose(q), T, atol=1e-14)


def test_geometry_is_refitted_where_the_arm_sags(sagging):
    """Better than the geometric half of the joint estimate, and what it costs is stated."""
    machine = of(sagging)
    assert machine.omitted == ("compliance",)
    geometry, full = machine.of("geometry"), machine.of("full")
    half = {p.name: p.value for p in sagging.document.parameters}
    half |= dict.fromkeys((n for n in half if "sag" in n), 0.0)
    (seen,) = seen_points(sagging.calibrated)
    readings = sagging.dataset.readings
    joints = {q: readings[q] for q in JOINTS}
    computed = traced(seen.steps, seen.target, joints, half).points
    rms = np.sqrt(np.square(computed - seen.measured(readings)).sum(axis=1).mean())
    assert full.measured.rms < geometry.measured.rms < 0.5 * rms
    assert geometry.from_full.rms == pytest.approx(geometry.measured.rms, rel=0.5)
    assert machine.values["q2_sag_tip"] == 0.0


def test_stated_u95_of_zeros_is_their_spread(rigid, monkeypatch):
    """Machines drawn from the covariance of the calibration, each refitted by its zeros."""
    monkeypatch.setattr(exporting, "_POSES", 40)
    machine = of(rigid)
    document = rigid.document
    names = document.covariance.names
    C = np.array(document.covariance.matrix)
    rng = np.random.default_rng(0)
    drawn = []
    for change in rng.multivariate_normal(np.zeros(len(names)), C, 40, method="eigh"):
        by = dict(zip(names, change, strict=True))
        moved = [replace(p, value=p.value + by.get(p.name, 0.0)) for p in document.parameters]
        values = {p.name: p.value for p in moved}
        machine_of_draw = rigid.calibrated.with_nominal(values)
        known = predictor(rigid)
        assert known is not None
        known = replace(known, mechanism=machine_of_draw)
        drawn_document = replace(document, parameters=tuple(moved))
        its = exported(drawn_document, machine_of_draw, rigid.dataset, known)
        drawn.append([zero.offset for zero in its.zeros])
    spread = np.std(drawn, axis=0)
    for zero, sd in zip(machine.zeros, spread, strict=True):
        if zero.determined:
            assert sd == pytest.approx(zero.u95 / 1.96, rel=0.35)


def test_derivatives_of_a_seen_point_are_its_differences(rigid):
    (seen,) = seen_points(rigid.calibrated)
    values = {p.name: p.nominal for p in rigid.calibrated.parameters}
    rng = np.random.default_rng(2)
    joints = {q: rng.uniform(-1, 1, 4) for q in JOINTS}
    found = traced(seen.steps, seen.target, joints, values).by
    h = 1e-6
    for name, column in found.items():
        ends = []
        for sign in (1.0, -1.0):
            moved, turned = dict(values), dict(joints)
            if name in moved:
                moved[name] += sign * h
            else:
                turned[name] = turned[name] + sign * h
            ends.append(traced(seen.steps, seen.target, turned, moved).points)
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * h), atol=1e-8)


def test_a_refit_returns_to_where_its_goals_come_from(rigid):
    (seen,) = seen_points(rigid.calibrated)
    values = {p.name: p.nominal for p in rigid.calibrated.parameters}
    rng = np.random.default_rng(3)
    joints = {q: rng.uniform(-1, 1, 40) for q in JOINTS}
    there = values | {"a_2": values["a_2"] + 5e-3, "tool_x": values["tool_x"] - 2e-3}
    shifted = joints | {"q3": joints["q3"] + 1e-2}
    goal = Goal(seen, joints, traced(seen.steps, seen.target, shifted, there).points)
    found = refit([goal], values, ["a_2", "tool_x"], ["q3"])
    assert found.values["a_2"] == pytest.approx(there["a_2"], abs=1e-12)
    assert found.offsets["q3"] == pytest.approx(1e-2, abs=1e-12)
    assert found.distances([goal]).max() < 1e-12
    base = [n for n in values if n.startswith(("base_", "tool_"))]
    assert separable([goal], values, base, JOINTS) == ("q2", "q3", "q4", "q5")


def test_offsets_of_frames_are_those_of_the_parameters(rigid):
    frames = {(f.name, f.seen_in, f.model): f for f in of(rigid).frames}
    value = {p.name: p.value for p in rigid.document.parameters}
    tool = frames["tool", "flange", "geometry"]
    np.testing.assert_allclose(tool.T[:3, 3], [value[f"tool_{a}"] for a in "xyz"])
    assert not tool.turned
    there = frames["base", "instrument", "geometry"].T
    back = frames["instrument", "base", "geometry"].T
    np.testing.assert_allclose(there @ back, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(there[:3, 3], [value[f"base_{a}"] for a in "xyz"])


def test_an_arm_on_a_wire_is_exported_too():
    """No point of it is measured: zeros and tool are compared at the point that the wire holds."""
    joints = [lc.Joint(q, form) for q, form in zip(JOINTS, FORMS, strict=True)]
    wires = [
        lc.instruments.draw_wire(f"wire{i}", anchor=f"wire{i}", target="tool") for i in range(3)
    ]
    nominal = NOMINAL | {"wire0_x": 1.0, "wire1_y": 1.2, "wire2_x": -0.6, "wire2_z": 1.5}
    arm = lc.fix_redundant(lc.assemble(lc.machines.serial(joints), wires, nominal))
    poses = lc.random_poses(RANGES, 80, seed=3)
    noise = lc.Noise({"q*": 2e-5, "wire*": 2e-5})
    wrong = {p.name: p.nominal for p in arm.parameters}
    wrong |= {n: wrong[n] + v for n, v in ZEROS.items() if n in arm.parameters.free}
    made = lc.simulate(arm, poses, noise=noise, seed=3, truth=wrong)
    machine = of(lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop"))
    assert machine.of("zeros and tool").from_full.rms < 2e-4
    assert [f.name for f in machine.frames if f.model == "geometry"] == ["tool"]
    for zero in machine.zeros:
        if zero.determined:
            true = ZEROS[f"offset_{zero.joint[1]}"]
            assert abs(zero.offset - true) < 2.0 * zero.u95


def test_transitions_hold_their_base_themselves():
    """The zero of joint 1 turns the base; a model error beside the sensors is no geometry."""
    arm = lc.motoman_ma1400(before={"rz": QUARTER})
    names = [f"theta_{i}" for i in range(1, 7)]
    poses = lc.random_poses(dict.fromkeys(names, (-1.0, 1.0)), 60, seed=5)
    noise = lc.Noise({"theta_*": 2e-5, **dict.fromkeys("xyz", 2e-5)})
    wrong = {p.name: p.nominal for p in arm.parameters}
    made = lc.simulate(arm, poses, noise=noise, seed=5, truth=wrong | {"z2": 0.615})
    learnt = lc.Noise({"theta_*": 2e-5, **dict.fromkeys("xyz", 2e-5), "model": 1e-4})
    result = lc.calibrate(arm, made.dataset, noise=learnt, method="implicit-loop")
    machine = of(result)
    assert [z.joint for z in machine.zeros if not z.determined] == ["theta_1", "theta_6"]
    assert machine.of("geometry").figures[3] == 0.0
    axes = {f.model: f for f in machine.frames if f.name == "axis of theta_1 (z)"}
    chain = machine.chain.along_z
    np.testing.assert_allclose(axes["geometry"].T, chain.joints[0].before, atol=1e-12)
    assert "zeros and tool" in axes
    with refused("unsupported", "origins"):  # and not: name a URDF
        lc.export(result, to="urdf")


def test_poses_before_a_slip_are_compared_as_after_it():
    """The tool slipped by 2 mm half-way; an export holds the machine as it is now."""
    poses = lc.random_poses(RANGES, 60, seed=4)
    poses = poses | {"number": np.arange(1.0, 61.0)}
    slip = lc.effects.Shift(("tool_x",), (31.0,), "number")
    mechanism = lc.with_effects(arm(), [slip])
    moved = next(n for n in mechanism.parameters.names if n not in arm().parameters.names)
    truth = {p.name: p.nominal for p in mechanism.parameters} | PLACED | {moved: 2e-3}
    made = lc.simulate(mechanism, poses, noise=NOISE, seed=4, truth=truth)
    machine = of(lc.calibrate(mechanism, made.dataset, noise=NOISE, method="implicit-loop"))
    assert machine.of("geometry").measured.rms == pytest.approx(
        machine.of("full").measured.rms, rel=0.05
    )
