"""Robots with several arms: what one arm can do, each of theirs can."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.robot.export_files import _written, export
from loopcal.companions.robot.exports.format import ExportOptions
from loopcal.companions.robot.exports.registry import format_named
from loopcal.estimation.fit import Fit, modelled
from loopcal.expressions.engine import engine_for
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.skeleton import skeleton, skeleton_labels
from loopcal.mechanisms.structure.structured import structured
from loopcal.statistics.region import ranges_of
from tests.refusals import refused

SIDES = {"left": 1.0, "right": -1.0}
JOINTS = ["waist", *(f"{side}_{i}" for side in SIDES for i in range(1, 5))]
TRUTH = {"tracker_x": 2.0, "tracker_y": 0.3, "tracker_rz": 0.5, "left_ball_x": 0.1}
TRUTH |= {"right_ball_x": 0.1, "left_3_x": 0.351}
NOISE = lc.Noise({**dict.fromkeys(JOINTS, 2e-5), "?_?": 5e-5})
AXES = ("0 0 1", "0 1 0", "1 0 0", "0 1 0")


def _joint(name: str, parent: str, child: str, xyz: str, axis: str) -> str:
    limits = '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'
    return (
        f'<joint name="{name}" type="revolute"><origin xyz="{xyz}" rpy="0 0 0"/>\n'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{limits}</joint>\n'
    )


def _link(name: str, mass: float) -> str:
    inertial = f'<inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/></inertial>'
    return f'<link name="{name}">{inertial if mass else ""}</link>\n'


def dual_arm(folder: Path, mass: float = 0.0) -> Path:
    """A URDF of a waist with two arms of four joints each; mass [kg] of each link."""
    text = '<?xml version="1.0"?>\n<robot name="twin">\n<!-- kept -->\n<link name="base"/>\n'
    text += _link("chest", mass) + _joint("waist", "base", "chest", "0 0 0.5", "0 0 1")
    for side, sign in SIDES.items():
        parent, xyz = "chest", f"0 {0.2 * sign} 0.3"
        for i, axis in enumerate(AXES, 1):
            child = f"{side}_hand" if i == len(AXES) else f"{side}_link{i}"
            text += _link(child, mass) + _joint(f"{side}_{i}", parent, child, xyz, axis)
            parent, xyz = child, "0.35 0 0.02"
    path = folder / "twin.urdf"
    path.write_text(text + "<!-- the end --></robot>\n", encoding="utf-8")
    return path


def twin(folder: Path, mass: float = 0.0) -> lc.Mechanism:
    """Both hands seen by one tracker."""
    data = {
        "type": "tree",
        "file": str(dual_arm(folder, mass)),
        "use": [f"{side}_hand" for side in SIDES],
        "gravity": [0, 1, -2],
        "instrument": [
            {
                "type": "point",
                "name": side[0],
                "on": f"{side}_hand",
                "station": "tracker",
                "target": f"{side}_ball",
                "readings": [f"{side[0]}_{axis}" for axis in "xyz"],
            }
            for side in SIDES
        ],
    }
    return mechanism_from_data(data, str(folder / "project.toml"))


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> lc.Result:
    """A twin whose left arm is 1 mm longer than drawn."""
    mechanism = twin(tmp_path_factory.mktemp("twin"))
    sds = {p.name: 2e-3 if p.unit == "m" else 5e-3 for p in mechanism.parameters if not p.fixed}
    placed = {n: math.inf for n in sds if n.startswith("tracker") or "ball" in n}
    mechanism = mechanism.with_parameters(mechanism.parameters.with_prior(sds | placed))
    truth = {p.name: p.nominal for p in mechanism.parameters} | TRUTH
    poses = lc.random_poses(dict.fromkeys(JOINTS, (-1.2, 1.2)), 40, seed=1)
    made = lc.simulate(mechanism, poses, noise=NOISE, seed=2, truth=truth)
    return lc.calibrate(mechanism, made.dataset, noise=NOISE, method="implicit-loop")


def test_joints_of_all_branches_have_ranges(calibrated: lc.Result) -> None:
    mechanism = calibrated.machine
    assert list(mechanism.joints) == JOINTS
    assert mechanism.chain == ()
    readings = {q: np.array([-0.1, 0.1]) for q in JOINTS}
    # those of the URDF, which states them for both arms
    assert [r.high for r in ranges_of(mechanism, readings, {})] == [1.5] * len(JOINTS)


def test_only_changed_origins_of_the_whole_urdf_are_patched(calibrated: lc.Result) -> None:
    done = export(calibrated, "urdf")
    (content,) = done.files.values()
    source = Path((calibrated.machine.description or {})["source"]).read_bytes()
    old, new = source.splitlines(), content.splitlines()
    assert len(old) == len(new)
    changed = {a.split()[1] for a, b in zip(old, new, strict=True) if a != b}
    # the waist stands where the tracker sees it stand, so that its origin stays
    assert changed == {f'name="{q}"'.encode() for q in JOINTS if q != "waist"}
    models = {one.model: one.measured.rms for one in done.machine.accuracy if one.measured}
    assert models["geometry"] < 2e-4 < 4e-4 < models["nominal"]
    placed = {(f.name, f.seen_in) for f in done.machine.frames if f.model == "geometry"}
    assert {("left_ball", "left_hand"), ("right_ball", "right_hand"), ("base", "tracker")} <= placed
    with refused("unsupported", "serial arm"):
        _written(format_named("dh"), done.machine, ExportOptions(), None)


def test_a_waist_gives_way_under_all_that_both_arms_weigh(tmp_path: Path) -> None:
    mechanism = structured(twin(tmp_path, mass=3.0), harmonics=False)
    tree = mechanism.tree
    assert tree is not None
    assert mechanism.structure is not None
    names = {column.parameter for column in mechanism.structure.columns}
    assert {f"waist_sag_z_{side}_hand_tool" for side in SIDES} <= names
    assert not {"left_2_sag_y_right_hand_tool", "right_2_sag_y_left_hand_tool"} & names
    rng = np.random.default_rng(0)
    q = dict(zip(JOINTS, rng.uniform(-1.0, 1.0, len(JOINTS)), strict=True))
    values = {p.name: p.nominal for p in mechanism.parameters}
    tape = mechanism.tape
    x = np.array([[q.get(name, 0.0)] for name in tape.quantities])
    by = ["waist_yield", "left_2_yield", "waist_sag_z_right_hand_tool"]
    engine = engine_for(tape, tuple(by), 1, ())
    slopes = engine.evaluate(np.array([*values.values()]), x, np.empty((0, 1))).by_parameter
    rows = (dict(zip(tape.loops, of_one[:, 0], strict=True)) for of_one in slopes)
    change = dict(zip(by, rows, strict=True))

    # by hand: the moment about the vertical axis of the waist, which turns both hands
    g = np.array([0.0, 1.0, -2.0]) / math.sqrt(5.0)
    moment = np.zeros(3)
    for load in mechanism.masses:
        body = next(
            name
            for name, link in tree.links.items()
            if load.joint in [step.joint for step in link.steps]
        )
        T = product(tree.path(body), q, values)
        moment += 9.80665 * 3.0 * np.cross((T @ [*load.point, 1.0])[:3], g)
    for side in SIDES:
        hand = product(tree.path(f"{side}_hand"), q, values)[:3, 3]
        moved = np.cross([0.0, 0.0, moment[2]], hand)
        seen = [change["waist_yield"][f"{side[0]}_{axis}"] for axis in "xyz"]
        assert np.abs(np.abs(seen) - np.abs(moved)).max() < 1e-9
    # what yields in the left arm leaves the right hand; the right arm's weight turns the left one
    assert [change["left_2_yield"][f"r_{axis}"] for axis in "xyz"] == [0.0, 0.0, 0.0]
    assert abs(change["waist_sag_z_right_hand_tool"]["l_x"]) > 1e-3


def test_the_skeleton_shows_both_arms(tmp_path: Path) -> None:
    mechanism = twin(tmp_path)
    lines, labels = skeleton(mechanism, dict.fromkeys(JOINTS, 0.0)), skeleton_labels(mechanism)
    assert lines is not None
    assert len(lines) == len(labels) == 2 * (1 + 4 + 2) + 1
    assert [q for q in labels if q in JOINTS] == JOINTS  # the waist, in both, is named once
    ends = lines[[labels.index(f"{side}_hand") for side in ("left", "right")]]
    assert ends == pytest.approx(np.array([[1.05, 0.2, 0.86], [1.05, -0.2, 0.86]]))


def test_unread_joints_of_one_arm_leave_the_waist_stiff(tmp_path: Path) -> None:
    mechanism = twin(tmp_path)
    read = {q: np.zeros(4) for q in (*JOINTS, *mechanism.outputs)}
    gaps = {q: np.array([0.0, 0.0, np.nan, np.nan]) for q in JOINTS if q.startswith("right")}
    bending = []
    for readings in (read, read | gaps):
        made = modelled(
            Fit(model_error="structured"), mechanism, Dataset(readings, {}, tuple("abcd"))
        )
        assert made.structure is not None
        bending.append({column.joint for column in made.structure.columns})
    assert bending[0] - bending[1] == {"waist"}


def test_a_hand_is_predicted_where_the_joints_of_the_other_are_unread(
    calibrated: lc.Result,
) -> None:
    q = np.random.default_rng(3).uniform(-0.5, 0.5, (len(JOINTS), 3))
    whole = dict(zip(JOINTS, q, strict=True))
    one_arm = {
        n: np.where([1, 1, 0], v, np.nan) if n[:5] == "right" else v for n, v in whole.items()
    }
    seen, partly = (calibrated.predict(readings).outputs for readings in (whole, one_arm))
    for axis in "xyz":
        np.testing.assert_array_equal(partly[f"l_{axis}"], seen[f"l_{axis}"])
        np.testing.assert_array_equal(partly[f"r_{axis}"][:2], seen[f"r_{axis}"][:2])
        assert np.isnan(partly[f"r_{axis}"][2])
