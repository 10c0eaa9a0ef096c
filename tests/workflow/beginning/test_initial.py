"""Files as people have them become projects whose fit gives the noise back."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.problem.problem import build_problem
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition import meanings
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.robots import dh_robot
from loopcal.workflow.beginning.initial import initial_project
from loopcal.workflow.beginning.robot_file import RobotFile
from tests.reference import dh_arm
from tests.refusals import refused

NOISE = 5e-5
NAMES = [f"J{i}" for i in range(1, 7)]


@pytest.fixture(scope="module")
def arm() -> tuple[np.ndarray, np.ndarray]:
    """Joints (N, 6) [rad] and points (N, 3) [m]."""
    joints = dh_arm.poses()
    return joints, dh_arm.seen(joints, sd=NOISE)[:, :3, 3]


@pytest.fixture(scope="module")
def camera() -> tuple[np.ndarray, np.ndarray]:
    """Joints (N, 6) [rad] and poses (N, 4, 4) [m]."""
    joints = dh_arm.poses()
    return joints, dh_arm.seen(joints, sd=NOISE, turned=2e-4)


def table(path: Path, columns: dict[str, Any], separator: str = ",", header: bool = True) -> Path:
    """A text file; numbers with nine decimals."""
    rows = [separator.join(columns)] if header else []
    for row in zip(*columns.values(), strict=True):
        cells = [c if isinstance(c, str) else f"{c:.9f}" for c in row]
        if separator == ";":
            cells = [c.replace(".", ",") for c in cells]
        rows.append(separator.join(cells))
    path.write_text("\n".join(rows) + "\n", "utf-8")
    return path


def dh(folder: Path) -> Path:
    path = folder / "dh.csv"
    path.write_text(dh_arm.dh_table(), "utf-8")
    return path


def of(values: np.ndarray, names: str | list[str]) -> dict[str, np.ndarray]:
    return dict(zip(names, np.asarray(values).T, strict=True))


def assert_gives_the_noise_back(folder: Path, noise: float = NOISE) -> None:
    """The project on the disk, fitted by least squares, leaves the noise of the points."""
    project = lc.read_project(folder / "project.toml")
    data = lc.load_dataset(project).dataset
    result = lc.calibrate(project.mechanism, data, method="least-squares")
    assert result.status.converged
    assert result.accuracy_after is not None
    left = result.accuracy_after.rms
    share = np.sqrt(1.0 - len(result.estimated) / (3.0 * len(data)))
    assert left == pytest.approx(noise * np.sqrt(3.0) * share, rel=0.15)


def quaternion(turns: np.ndarray) -> np.ndarray:
    """(N, 4), w last."""
    return np.asarray(Rotation.from_matrix(turns).as_quat())


def test_split_files_are_joined_by_their_ids(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    ids = [f"P{i:03d}" for i in range(len(joints))]
    order = np.random.default_rng(0).permutation(len(joints))
    a = table(tmp_path / "joints.csv", {"pose": ids, **of(joints, NAMES)})
    seen = {"Point ID": [ids[i] for i in order], **of(points[order], ["Tx", "Ty", "Tz"])}
    b = table(tmp_path / "tracker.csv", seen)
    made = lc.init(a, b, dh=dh(tmp_path), out=tmp_path / "out")
    assert len(made.dataset) == len(joints)
    assert_gives_the_noise_back(tmp_path / "out")


def test_split_files_are_joined_by_names_beside_their_numbers(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    names = [f"{'abc'[i % 3]}{i // 3}" for i in range(len(joints))]
    order = np.random.default_rng(0).permutation(len(joints))
    a = table(tmp_path / "program.csv", {"Target name": names, **of(joints, NAMES)})
    shots = np.arange(1.0, 1.0 + len(joints))
    seen = {"Shot": shots, "Target name": [names[i] for i in order]}
    b = table(tmp_path / "measured.csv", {**seen, **of(points[order], ["X", "Y", "Z"])})
    made = lc.init(a, b, dh=dh(tmp_path), out=tmp_path / "out")
    assert made.dataset.poses == tuple(names)
    assert any("joined by the names they share" in words for words in made.remarks)
    assert_gives_the_noise_back(tmp_path / "out")


def test_units_that_nobody_states_are_those_of_the_machine(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(np.degrees(joints), NAMES), **of(1e3 * points, ["x", "y", "z"])}
    made = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert any("J6 in deg; x, y, z in mm" in words for words in made.remarks)
    assert_gives_the_noise_back(tmp_path / "out")


def test_how_much_of_the_work_is_done_is_said(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(np.degrees(joints), NAMES), **of(1e3 * points, ["x", "y", "z"])}
    said: list[tuple[str, int]] = []
    initial_project(
        [table(tmp_path / "a.csv", columns)],
        RobotFile(dh=dh(tmp_path)),
        out=None,
        progress=lambda what, percent: said.append((what, percent)),
    )
    percents = [percent for _, percent in said]
    assert percents == sorted({*percents})
    assert 0 in percents
    assert max(percents) < 100
    assert len({what for what, _ in said}) == len(said) > 3


@pytest.mark.parametrize(("angle", "length"), [("gon", "in"), ("rad", "cm"), ("deg", "m")])
def test_every_pair_of_units_is_recognised(
    tmp_path: Path, arm: Any, angle: str, length: str
) -> None:
    joints, points = arm
    turned = joints * {"gon": 200 / np.pi, "rad": 1.0, "deg": 180 / np.pi}[angle]
    moved = points / {"in": 0.0254, "cm": 0.01, "m": 1.0}[length]
    made = lc.init({**of(turned, NAMES), **of(moved, ["x", "y", "z"])}, dh=dh(tmp_path))
    assert np.allclose(made.dataset["J2"], joints[:, 1])
    assert np.allclose(made.dataset["x"], points[:, 0])


def test_units_of_headers_are_read(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    names = [f"J{i} [deg]" for i in range(1, 7)]
    columns = {**of(np.degrees(joints), names), **of(1e3 * points, ["X (mm)", "Y (mm)", "Z (mm)"])}
    made = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert not any("Inferred" in words for words in made.remarks)
    assert_gives_the_noise_back(tmp_path / "out")


def test_a_row_of_units_below_the_header(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(np.degrees(joints), NAMES), **of(1e3 * points, "xyz")}
    path = table(tmp_path / "a.csv", columns)
    head, *rows = path.read_text("utf-8").splitlines()
    units = ",".join(["deg"] * 6 + ["mm"] * 3)
    path.write_text("\n".join([head, units, *rows]) + "\n", "utf-8")
    made = lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert not any("Inferred" in words for words in made.remarks)
    assert_gives_the_noise_back(tmp_path / "out")


def test_decimal_commas_and_semicolons(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(np.degrees(joints), NAMES), **of(1e3 * points, ["x1", "y1", "z1"])}
    path = table(tmp_path / "a.csv", columns, separator=";")
    lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert_gives_the_noise_back(tmp_path / "out")


@pytest.mark.parametrize("joints_first", [True, False])
def test_a_file_without_a_header(tmp_path: Path, arm: Any, joints_first: bool) -> None:
    joints, points = arm
    parts = [of(np.degrees(joints), NAMES), of(1e3 * points, "xyz")]
    first, second = parts if joints_first else parts[::-1]
    columns = {"n": [str(i + 1) for i in range(len(joints))], **first, **second}
    path = table(tmp_path / "a.txt", columns, separator="\t", header=False)
    lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert_gives_the_noise_back(tmp_path / "out")


def test_a_quaternion_with_w_last_is_recognised_by_the_data(tmp_path: Path, camera: Any) -> None:
    joints, T = camera
    columns = {
        **of(joints, NAMES),
        **of(T[:, :3, 3], "xyz"),
        **of(quaternion(T[:, :3, :3]), ["quat0", "quat1", "quat2", "quat3"]),
    }
    made = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert any("in the order x, y, z, w" in words for words in made.remarks)
    assert made.mechanism.parameters["tool_x"].nominal == pytest.approx(0.05, abs=5e-3)
    assert_gives_the_noise_back(tmp_path / "out")


def test_a_quaternion_with_w_first_under_names_that_have_it_last_is_recognised(
    tmp_path: Path, camera: Any
) -> None:
    joints, T = camera
    turned = np.roll(quaternion(T[:, :3, :3]), 1, axis=1)
    columns = {**of(joints, NAMES), **of(T[:, :3, 3], "xyz")}
    columns |= of(turned, ["qx", "qy", "qz", "qw"])
    made = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert any("qw, qx, qy, qz in the order z, w, x, y" in words for words in made.remarks)
    assert_gives_the_noise_back(tmp_path / "out")


@pytest.mark.parametrize(("one", "other"), [("qw", "qx"), ("qy", "qw"), ("qx", "qz")])
def test_numbers_of_a_quaternion_under_each_others_headers_are_named(
    tmp_path: Path, camera: Any, one: str, other: str
) -> None:
    joints, T = camera
    turned = np.roll(quaternion(T[:, :3, :3]), 1, axis=1)
    columns = {**of(joints, NAMES), **of(T[:, :3, 3], "xyz")}
    columns |= of(turned, ["qw", "qx", "qy", "qz"])
    columns[one], columns[other] = columns[other], columns[one]
    named = rf"(?s)({one}, {other}|{other}, {one}) are under each other's headers"
    with pytest.raises(lc.InputError, match=named):
        lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")


def test_inverse_rotations_beside_points_are_named(tmp_path: Path, camera: Any) -> None:
    joints, T = camera
    inverse = np.roll(quaternion(np.linalg.inv(T[:, :3, :3])), 1, axis=1)
    columns = {**of(joints, NAMES), **of(T[:, :3, 3], "xyz")}
    columns |= of(inverse, ["qw", "qx", "qy", "qz"])
    with pytest.raises(lc.InputError, match="qw, qx, qy, qz hold the inverse rotation"):
        lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")


def test_poses_without_a_quaternion_have_no_made_up_orientation(
    camera: Any,
) -> None:
    joints, T = camera
    turns = quaternion(T[:, :3, :3])
    missing = np.arange(len(joints)) % 2 == 0
    turns[missing] = np.nan
    fields = [Field(0, i, None, column) for i, column in enumerate(turns.T)]
    seen: Any = SimpleNamespace(kind="pose", turned=fields, form="quaternion")
    for *_, R, _words in meanings._orientations(seen, as_stated=False):
        assert R is not None
        assert np.isnan(R[missing]).all()
        assert np.isfinite(R[~missing]).all()


def test_a_pose_of_the_station_seen_from_the_target_is_turned_round(
    tmp_path: Path, camera: Any
) -> None:
    joints, T = camera
    inverse = np.linalg.inv(T)
    columns = {
        **of(joints, NAMES),
        **of(1e3 * inverse[:, :3, 3], "xyz"),
        **of(np.roll(quaternion(inverse[:, :3, :3]), 1, axis=1), ["qw", "qx", "qy", "qz"]),
    }
    made = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert "readings.csv" in made.tables
    assert_gives_the_noise_back(tmp_path / "out")


@pytest.mark.parametrize("names", ["T", "m_"])
def test_matrices_are_converted(tmp_path: Path, camera: Any, names: str) -> None:
    joints, T = camera
    first = 1 if names == "T" else 0
    cells = [f"{names}{i + first}{j + first}" for i in range(4) for j in range(4)]
    shown = T.copy()
    shown[:, :3, 3] *= 1e3
    columns = {**of(np.degrees(joints), NAMES), **of(shown.reshape(-1, 16), cells)}
    lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path), out=tmp_path / "out")
    assert_gives_the_noise_back(tmp_path / "out")


def test_rotation_vectors_and_kuka_angles(tmp_path: Path, camera: Any) -> None:
    joints, T = camera
    turns = Rotation.from_matrix(T[:, :3, :3])
    numbers = of(turns.as_rotvec(), ["rx", "ry", "rz"])
    vector = {**of(joints, NAMES), **of(T[:, :3, 3], "xyz"), **numbers}
    made = lc.init(table(tmp_path / "a.csv", vector), dh=dh(tmp_path), out=tmp_path / "out")
    assert made.mechanism.orientations[0].form == "rotation-vector"
    assert not made.tables
    assert_gives_the_noise_back(tmp_path / "out")
    angles = turns.as_euler("ZYX", degrees=True)
    kuka = {**of(joints, NAMES), **of(1e3 * T[:, :3, 3], ["X", "Y", "Z"]), **of(angles, "ABC")}
    lc.init(table(tmp_path / "b.csv", kuka), dh=dh(tmp_path), out=tmp_path / "kuka")
    assert_gives_the_noise_back(tmp_path / "kuka")


def test_a_urdf_gives_the_chain_that_has_these_joints(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    (tmp_path / "arm.urdf").write_text(dh_arm.urdf(), "utf-8")
    columns = {**of(joints, ["q1", "q2", "q3", "q4", "q5", "q6"]), **of(points, "xyz")}
    path = table(tmp_path / "a.csv", columns)
    lc.init(path, urdf=tmp_path / "arm.urdf", out=tmp_path / "out")
    text = (tmp_path / "out/project.toml").read_text("utf-8")
    assert 'file = "../arm.urdf"' in text
    assert 'tip = "tool0"' in text
    assert_gives_the_noise_back(tmp_path / "out")


def test_a_frame_in_memory_gives_the_same_project_as_its_file(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    a = lc.init(table(tmp_path / "a.csv", columns), dh=dh(tmp_path))
    b = lc.init(columns, dh=dh(tmp_path))
    c = lc.init(lc.Dataset.from_arrays(columns), dh=dh(tmp_path))
    for other in (b, c):
        assert other.mechanism.parameters == a.mechanism.parameters
        assert np.allclose(other.dataset["x"], a.dataset["x"], atol=1e-9)
    result = lc.calibrate(a.mechanism, a.dataset, method="least-squares")
    assert result.status.converged
    assert not a.written


def test_rows_joined_by_order_are_said_and_a_shift_is_refused(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    a, b = of(joints, NAMES), of(points, "xyz")
    made = lc.init(a, b, dh=dh(tmp_path))
    assert any("joined by order" in words for words in made.remarks)
    late = of(np.roll(points, 1, axis=0), "xyz")
    path = dh(tmp_path)
    with refused("mismatched-poses"):
        lc.init(a, late, dh=path)


def test_files_of_unequal_length_without_ids_are_joined_only_with_proof(
    tmp_path: Path, arm: Any
) -> None:
    joints, points = arm
    path = dh(tmp_path)
    made = lc.init(of(joints, NAMES), of(points[1:], "xyz"), dh=path)
    assert np.allclose(made.dataset["J2"], joints[1:, 1])
    order = np.random.default_rng(0).permutation(len(points))[1:]
    with refused("mismatched-poses"):
        lc.init(of(joints, NAMES), of(points[order], "xyz"), dh=path)


def test_a_wrong_stated_unit_never_converges_silently(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(joints, NAMES), **of(points, ["x [mm]", "y [mm]", "z [mm]"])}
    path = dh(tmp_path)
    with refused("wrong-unit"):
        lc.init(columns, dh=path)


def test_what_the_data_cannot_decide_is_asked_or_refused(tmp_path: Path) -> None:
    """Of an arm that hardly moves, 1 deg and 1 gon are alike."""
    joints = dh_arm.poses(30, limits=0.02 * dh_arm.LIMITS)
    points = dh_arm.seen(joints, sd=2e-3)[:, :3, 3]
    columns = {**of(np.degrees(joints), NAMES), **of(points, "xyz")}
    path = dh(tmp_path)
    with refused("unknown-unit"):
        lc.init(columns, dh=path)
    asked: list[str] = []

    def answer(question: str, answers: Any) -> int:
        asked.extend(answers)
        return next(i for i, words in enumerate(answers) if "deg" in words)

    made = initial_project([columns], RobotFile(dh=path), out=None, ask=answer)
    assert len(asked) > 1
    assert np.allclose(made.dataset["J1"], joints[:, 0])


@pytest.mark.parametrize("names", [["J2"], ["J5"], ["J1", "J4"]])
def test_joints_that_count_the_other_way_round_are_named(
    tmp_path: Path, arm: Any, names: list[str]
) -> None:
    joints, points = arm
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    columns |= {name: -columns[name] for name in names}
    path = dh(tmp_path)
    with refused("implausible-readings", *names, "other way round"):
        lc.init(columns, dh=path)


@pytest.mark.parametrize(
    ("counted", "stated"),
    [
        ({"J3": (1, 90), "J5": (1, 90)}, "J1,J2,J3-90,J4,J5-90,J6"),
        ({"J2": (1, -90), "J3": (1, -90)}, "J1,J2+90,J3+90,J4,J5,J6"),
    ],
)
def test_joints_that_count_from_other_zeros_are_named_together(
    tmp_path: Path, arm: Any, counted: dict[str, tuple[int, int]], stated: str
) -> None:
    """The second leaves as much as before while only one of the two joints is right."""
    joints, points = arm
    columns = {**of(np.degrees(joints), NAMES), **of(points, "xyz")}
    for name, (sign, zero) in counted.items():
        columns[name] = sign * columns[name] + zero
    path = dh(tmp_path)
    with refused("implausible-readings", " and ".join(counted), "other zeros") as caught:
        lc.init(columns, dh=path)
    assert caught.value.options == ("--joints", stated)
    assert lc.init(columns, dh=path, joints=stated).rms < 5e-3


def test_points_that_were_not_read_again_are_named(tmp_path: Path, arm: Any) -> None:
    """A pose may be measured twice, and a target on the axis that turns stands still."""
    joints, points = (values[:40].copy() for values in arm)
    joints[21], points[21] = joints[20], points[20] + NOISE
    joints[25], points[25] = joints[24] + [0, 0, 0, 0, 0, 1e-3], points[24]
    points[[7, 12, 31]] = points[[6, 11, 30]]
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    with refused("implausible-readings", "3 of 40", "not read again") as caught:
        lc.init(columns, dh=dh(tmp_path))
    assert caught.value.options == ("--exclude", "8,13,32")


def test_points_that_were_not_read_again_are_named_of_all_stations_at_once(
    tmp_path: Path, arm: Any
) -> None:
    joints, points = (values[:40].copy() for values in arm)
    points[[7, 31]] = points[[6, 30]]
    where = {"Station": np.repeat([1.0, 2.0], 20)}
    with refused("implausible-readings", "2 of 40", "not read again") as caught:
        lc.init({**of(joints, NAMES), **of(points, "xyz"), **where}, dh=dh(tmp_path))
    assert caught.value.options == ("--exclude", "8,32")


def test_a_tip_that_the_arm_turns_about_was_read_each_time(tmp_path: Path, arm: Any) -> None:
    """The wrist turns about the reflector, and readings of 0.1 mm repeat."""
    joints, points = (values[:40].copy() for values in arm)
    ways = np.random.default_rng(3)
    for i in (8, 9, 20, 21, 30):
        joints[i] = _about_the_tip(joints[i - 1], ways)
        points[i] = points[i - 1]
    columns = {**of(joints, NAMES), **of(np.round(points, 4), "xyz")}
    assert lc.init(columns, dh=dh(tmp_path)).rms < 5e-3


def _about_the_tip(joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Other joints with the reflector where it was and the hand turned."""
    tip = dh_arm.seen(joints[None], sd=0.0)[0, :3, 3]
    begin = joints + 0.3 * rng.standard_normal(6)
    made = least_squares(lambda q: dh_arm.seen(q[None], sd=0.0)[0, :3, 3] - tip, begin)
    assert np.linalg.norm(made.fun) < 1e-6
    return np.asarray(made.x)


def test_gaps_of_a_joint_are_no_fault_of_the_file(tmp_path: Path, arm: Any) -> None:
    """A joint missing in a few poses, and coordinates in others."""
    joints, points = (values[:60].copy() for values in arm)
    joints[50:55, 3], points[5:20, 0], points[30:42] = np.nan, np.nan, np.nan
    made = lc.init({**of(joints, NAMES), **of(points, "xyz")}, dh=dh(tmp_path))
    assert made.rms < 5e-3
    problem = build_problem(made.mechanism, made.dataset, made.noise)
    assert not column_faults(problem)


def test_a_direction_in_the_table_of_the_robot_turns_a_joint_round(
    tmp_path: Path, arm: Any
) -> None:
    joints, points = arm
    head, *rows = dh_arm.dh_table().splitlines()
    rows = [f"{row},{-1 if row.startswith('J3') else 1}" for row in rows]
    (tmp_path / "dh.csv").write_text("\n".join([f"{head},direction", *rows]) + "\n", "utf-8")
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    columns["J3"] = -columns["J3"]
    path = table(tmp_path / "a.csv", columns)
    lc.init(path, dh=tmp_path / "dh.csv", out=tmp_path / "out")
    assert_gives_the_noise_back(tmp_path / "out")


def test_a_tracker_in_its_own_readings(tmp_path: Path, arm: Any) -> None:
    joints, p = arm
    r = np.linalg.norm(p, axis=1)
    azimuth, elevation = np.arctan2(p[:, 1], p[:, 0]), np.arcsin(p[:, 2] / r)
    seen = {"range": 1e3 * r, "az": np.degrees(azimuth), "el": np.degrees(elevation)}
    path = table(tmp_path / "a.csv", {**of(joints, NAMES), **seen})
    made = lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert set(made.fits) == {"tracker"}
    assert_gives_the_noise_back(tmp_path / "out")


def test_two_targets_are_seen_from_one_station(tmp_path: Path, camera: Any) -> None:
    joints, T = camera
    other = T[:, :3, 3] + T[:, :3, :3] @ np.array([0.1, 0.02, 0.0])
    names = ["x1", "y1", "z1", "x2", "y2", "z2"]
    both = of(1e3 * np.hstack([T[:, :3, 3], other]), names)
    made = lc.init({**of(joints, NAMES), **both}, dh=dh(tmp_path))
    between = [
        made.mechanism.parameters[f"tool_1_{a}"].nominal
        - made.mechanism.parameters[f"tool_2_{a}"].nominal
        for a in "xyz"
    ]
    assert np.linalg.norm(between) == pytest.approx(np.hypot(0.1, 0.02), abs=2e-3)
    assert "base_x" in made.mechanism.parameters.names


def test_two_targets_in_turn_under_one_name_are_told_apart(tmp_path: Path, camera: Any) -> None:
    joints, T = camera
    second = np.random.default_rng(5).random(len(T)) < 0.4
    offset = np.where(second[:, None], [0.1, 0.02, 0.0], 0.0)
    points = T[:, :3, 3] + np.einsum("nij,nj->ni", T[:, :3, :3], offset)
    rows = ", ".join(map(str, np.flatnonzero(second) + 1))
    with refused("implausible-readings", "two targets in turn", f"({rows})"):
        lc.init({**of(joints, NAMES), **of(points, "xyz")}, dh=dh(tmp_path))


@pytest.mark.parametrize("share", [0.05, 0.15, 0.4])
def test_two_targets_that_are_swapped_in_some_rows_are_named(
    tmp_path: Path, camera: Any, share: float
) -> None:
    """As points of one target they were "two targets in turn", or their misfit the arm's."""
    joints, T = camera
    one = 1e3 * T[:, :3, 3]
    other = one + T[:, :3, :3] @ np.array([100.0, 20.0, 0.0])
    swapped = np.random.default_rng(5).random((len(T), 1)) < share
    points = np.hstack([np.where(swapped, other, one), np.where(swapped, one, other)])
    rows = ", ".join(map(str, np.flatnonzero(swapped) + 1))
    names = ["x1", "y1", "z1", "x2", "y2", "z2"]
    with refused("implausible-readings", "are swapped in", f"({rows})"):
        lc.init({**of(joints, NAMES), **of(points, names)}, dh=dh(tmp_path))


def test_another_robot_is_refused_and_shuffled_points_are_named(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    rng, path = np.random.default_rng(3), dh(tmp_path)
    elsewhere = points.mean(axis=0) + points.std() * rng.standard_normal(points.shape)
    with refused("implausible-readings"):
        lc.init({**of(joints, NAMES), **of(elsewhere, "xyz")}, dh=path)
    shuffled = {**of(joints, NAMES), **of(rng.permutation(points), "xyz")}
    with refused("mismatched-poses"):
        lc.init(shuffled, dh=path)


def test_a_project_gives_way_to_another_until_it_is_changed(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    path, out = dh(tmp_path), tmp_path / "out"
    lc.init(columns, dh=path, out=out)
    lc.init({n: column[:30] for n, column in columns.items()}, dh=path, out=out)
    assert len(lc.load_dataset(lc.read_project(out / "project.toml")).dataset) == 30
    with (out / "readings.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    with refused("unwritable-file", "readings.csv"):
        lc.init(columns, dh=path, out=out)
    with (out / "project.toml").open("a", encoding="utf-8") as file:
        file.write("# mine\n")
    with refused("unwritable-file", "project.toml"):
        lc.init(columns, dh=path, out=out)


def test_joints_beyond_the_arm_that_stand_still_do_not_choose_the_chain(tmp_path: Path) -> None:
    """Fingers of a gripper: no chain holds both, and each has a joint more than the arm."""
    dh_arm.write_slipped(tmp_path)
    urdf = tmp_path / "arm.urdf"
    joint = (
        '<link name="other"/><joint name="grip_2" type="prismatic"><parent link="tool0"/>'
        '<child link="other"/><axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="0" '
        'velocity="1"/></joint></robot>'
    )
    urdf.write_text(urdf.read_text("utf-8").replace("</robot>", joint), "utf-8")
    read = pl.read_csv(tmp_path / "poses.csv").with_columns(grip=0.02, grip_2=0.02)
    made = lc.init(read, urdf=urdf)
    assert len(made.mechanism.joints) == 6
    assert made.inputs["mechanism"]["tip"] == "tool0"


def test_too_many_joint_columns_are_listed(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    names = [f"q{i}" for i in range(1, 8)]
    columns = {**of(np.hstack([joints, joints[:, :1]]), names), **of(points, "xyz")}
    path = dh(tmp_path)
    with refused("missing-column"):
        lc.init(columns, dh=path)


def test_real_files_are_understood(tmp_path: Path, shared_data: Callable[[str], Path]) -> None:
    tracker = shared_data("motoman_ma1400_leica/right_arm_workspace.csv")
    rows = (
        "a,d,alpha,theta\n.15,1.4159,-90,0\n.614,0,180,-90\n.2,0,-90,0\n0,-.64,90,0\n"
        ".03,0,90,-90\n0,.2,0,0\n"
    )
    (tmp_path / "ma.csv").write_text(rows, "utf-8")
    made = lc.init(tracker, dh=tmp_path / "ma.csv", out=tmp_path / "ma")
    assert made.worst[0] == "13"
    assert made.rms < 3e-3
    assert made.mechanism.parameters["tool_x"].nominal == pytest.approx(0.0418, abs=5e-3)
    wire = shared_data("abb_irb120_cable/RobotCali.xlsx")
    rows = (
        "a;d;alpha;theta\n0;290;-90;0\n270;0;0;-90\n70;0;-90;0\n0;302;90;0\n0;0;-90;0\n0;72;0;180\n"
    )
    (tmp_path / "irb.csv").write_text(rows, "utf-8")
    made = lc.init(wire, dh=tmp_path / "irb.csv", out=tmp_path / "irb")
    assert list(made.fits) == ["wire"]
    assert made.rms < 0.5e-3
    assert any("computed by the controller" in words for words in made.remarks)


def test_an_existing_project_is_met_before_any_work(tmp_path: Path, arm: Any) -> None:
    (tmp_path / "project.toml").write_text("mine", "utf-8")
    with refused("unwritable-file", "project.toml"):
        lc.init(tmp_path / "none.csv", dh=tmp_path / "none.csv", out=tmp_path)
    assert (tmp_path / "project.toml").read_text("utf-8") == "mine"


def test_slides_are_stated_in_units_of_length(tmp_path: Path) -> None:
    path = tmp_path / "dh.csv"
    path.write_text("name,a,d,alpha,theta,type\nX1,0,300,90,0,p\nA2,400,0,0,0,r\nA3,300,0,0,0,r\n")
    rng = np.random.default_rng(3)
    slide, *turns = rng.uniform([[0.0], [-1.2], [-2.0]], [[0.6], [1.2], [2.0]], (3, 60))
    c, s = np.cumsum(turns, axis=0), 0.4
    plane = [s * np.cos(c[0]) + 0.35 * np.cos(c[1]), s * np.sin(c[0]) + 0.35 * np.sin(c[1])]
    points = np.array([plane[0] + 1.0, -0.04 * np.ones(60) + 0.2, plane[1] + slide + 0.3])
    points += 2e-5 * rng.standard_normal(points.shape)
    columns = {"X1": 1e3 * slide, "A2": np.degrees(turns[0]), "A3": np.degrees(turns[1])}
    made = lc.init({**columns, **of(1e3 * points.T, "xyz")}, dh=path)
    told = " ".join(made.remarks)
    assert "the joints A2, A3 in deg; the slides X1 in mm" in told
    assert np.allclose(made.dataset["X1"], slide)


def test_a_shift_says_by_what_the_rows_were_joined(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    ids = [f"P{i}" for i in range(len(joints))]
    a = {"pose": ids[:-1], **of(joints[1:], NAMES)}
    b = {"pose": ids[:-1], **of(points[:-1], "xyz")}
    with refused("mismatched-poses", "joined by pose id", "correct the pose ids"):
        lc.init(a, b, dh=dh(tmp_path))
    with refused("mismatched-poses", "in the same file"):
        lc.init({**of(joints[1:], NAMES), **of(points[:-1], "xyz")}, dh=dh(tmp_path))


def test_sds_of_a_dataset_are_kept(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    data = lc.Dataset.from_arrays(
        {**of(joints, NAMES), **of(points, "xyz")},
        sds=dict.fromkeys("xyz", 7e-5 + 0.0 * joints[:, 0]),
    )
    made = lc.init(data, dh=dh(tmp_path))
    assert np.allclose(made.dataset.sds["y"], 7e-5)


def test_poses_that_are_not_in_every_file_are_said(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    ids = np.arange(len(joints))
    parts = [
        {"pose": ids, **of(joints[:, :3], NAMES[:3])},
        {"pose": ids, **of(joints[:, 3:], NAMES[3:])},
    ]
    seen = {"pose": ids[5:], **of(points[5:], "xyz")}
    made = lc.init(*parts, seen, dh=dh(tmp_path))
    assert len(made.dataset) == len(joints) - 5
    assert any("5 poses are not in every file" in words for words in made.remarks)


def test_a_sheet_may_have_an_apostrophe(tmp_path: Path, arm: Any) -> None:
    import polars as pl

    joints, points = arm
    frame = pl.DataFrame({**of(np.degrees(joints), NAMES), **of(1e3 * points, "xyz")})
    frame.write_excel(tmp_path / "a.xlsx", worksheet="Monday's run")
    lc.init(tmp_path / "a.xlsx", dh=dh(tmp_path), out=tmp_path / "out")
    assert len(lc.load_dataset(tmp_path / "out" / "project.toml").dataset) == len(joints)


@pytest.mark.parametrize("header", [True, False])
def test_matrices_column_by_column(tmp_path: Path, camera: Any, header: bool) -> None:
    joints, seen = camera
    names = [f"m{i}" for i in range(16)]
    by_columns = of(seen.transpose(0, 2, 1).reshape(-1, 16), names)
    path = table(tmp_path / "a.csv", {**of(joints, NAMES), **by_columns}, header=header)
    made = lc.init(path, dh=dh(tmp_path))
    assert np.allclose(made.dataset["y"], seen[:, 1, 3])
    assert made.rms < 1e-3
    turns = seen[:, :3, :3].transpose(0, 2, 1).reshape(-1, 9)
    columns = {
        **of(turns, [f"r{i}" for i in range(1, 10)]),
        **of(seen[:, :3, 3], ["t1", "t2", "t3"]),
    }
    made = lc.init({**of(joints, NAMES), **columns}, dh=dh(tmp_path))
    assert made.rms < 1e-3


@pytest.mark.parametrize("names", ["range hz v", "SD HA VA"])
def test_a_total_station_counts_clockwise_and_from_the_zenith(
    tmp_path: Path, arm: Any, names: str
) -> None:
    joints, points = arm
    far, (distance, turn, rise) = np.linalg.norm(points, axis=1), names.split()
    columns = {
        f"{distance} [m]": far,
        f"{turn} [gon]": -np.arctan2(points[:, 1], points[:, 0]) * 200.0 / np.pi,
        f"{rise} [gon]": 100.0 - np.arcsin(points[:, 2] / far) * 200.0 / np.pi,
    }
    path = table(tmp_path / "a.csv", {**of(joints, NAMES), **columns})
    made = lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert any("clockwise" in words and "zenith" in words for words in made.remarks)
    assert np.allclose(made.dataset["tracker_elevation"], np.arcsin(points[:, 2] / far))
    data = lc.load_dataset(tmp_path / "out" / "project.toml").dataset
    assert np.allclose(data["tracker_azimuth"], np.arctan2(points[:, 1], points[:, 0]))


def test_two_trackers_of_one_reflector_are_two_stations(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    T = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    noise = NOISE * np.random.default_rng(7).standard_normal(points.shape)
    other = points @ T.T + np.array([0.3, 0.2, 0.1]) + noise
    columns = {**of(points, ["x1", "y1", "z1"]), **of(other, ["x2", "y2", "z2"])}
    made = lc.init({**of(joints, NAMES), **columns}, dh=dh(tmp_path))
    names = made.mechanism.parameters.names
    assert "station_2_x" in names
    assert any("x_2, y_2, z_2: target tool, station station_2" in w for w in made.remarks)
    assert [n for n in names if n.startswith("tool")] == ["tool_x", "tool_y", "tool_z"]
    result = lc.calibrate(made, method="least-squares")
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms < 4.0 * NOISE


def test_what_does_not_fit_is_explained(tmp_path: Path, arm: Any) -> None:
    joints, points = (values[:48] for values in arm)
    path, own = dh(tmp_path), of(joints, NAMES)
    with refused("implausible-readings", "left-handed"):
        lc.init({**own, **of(points[:, [1, 0, 2]], "xyz")}, dh=path)
    with refused("wrong-unit", "x is in mm", "in m"):
        lc.init({**own, **of(points * (1e3, 1.0, 1.0), "xyz")}, dh=path)
    moved = points.copy()
    moved[30:] += (0.4, -0.2, 0.0)
    with refused("implausible-readings", "moved during the run", "add a column 'station'"):
        lc.init({**own, **of(moved, "xyz")}, dh=path)
    run = {"run": 1.0 + (np.arange(len(moved)) >= 30)}
    with refused("implausible-readings", "moved during the run", "rename the column 'run'"):
        lc.init({**own, **of(moved, "xyz"), **run}, dh=path)
    shuffled = points[np.random.default_rng(1).permutation(len(points))]
    with refused("mismatched-poses", "row by row", "loopcal init"):
        lc.init({**own, **of(shuffled, "xyz")}, dh=path)
    still = points * (1.0, 1.0, 0.0) + (0.0, 0.0, 0.5)
    with refused("implausible-readings", "z reads the same value in every row"):
        lc.init({**own, **of(still, "xyz")}, dh=path)
    counts = np.round(np.random.default_rng(1).permuted(joints, axis=0) * 2**20 / 2 / np.pi)
    with refused("implausible-readings", "counts of encoders"):
        lc.init({**of(counts, NAMES), **of(points, "xyz")}, dh=path)
    still = 1e-5 * np.random.default_rng(1).standard_normal((20, 9))
    columns = np.hstack([joints[:1], points[:1]]) + still
    with refused("too-few-poses", "one pose", "loopcal noise"):
        lc.init(of(columns, [*NAMES, "x", "y", "z"]), dh=path)


@pytest.mark.parametrize("each", [1, 3])
def test_rows_in_another_unit_are_named(tmp_path: Path, arm: Any, each: int) -> None:
    """A second file, or every third pose, was exported in inches."""
    joints, points = arm
    rows = np.arange(len(points)) % 3 == 0 if each == 3 else np.arange(len(points)) >= 20
    points = 1e3 * np.where(rows[:, None], points / 25.4, points)
    names = [f"{c} [mm]" for c in "xyz"]
    path = table(tmp_path / "m.csv", of(np.degrees(joints), NAMES) | of(points, names))
    first = f"rows 21 to {len(points)} of" if each == 1 else "(the first is 1) of"
    with refused("wrong-unit", first, "in inches", "others are in mm"):
        lc.init(path, dh=dh(tmp_path))


@pytest.mark.parametrize("each", [1, 3])
def test_rows_whose_joints_are_in_another_unit_are_named(
    tmp_path: Path, arm: Any, each: int
) -> None:
    """The instrument was said to have moved, with a column to be added for it."""
    joints, points = arm
    rows = np.arange(len(points)) % 3 == 0 if each == 3 else np.arange(len(points)) >= 20
    mixed = np.where(rows[:, None], np.degrees(joints), joints)
    with refused("wrong-unit", "are in radians", "are in degrees"):
        lc.init({**of(mixed, NAMES), **of(points, "xyz")}, dh=dh(tmp_path))


def test_a_last_reading_that_is_repeated_to_the_end_is_named(tmp_path: Path, arm: Any) -> None:
    """The instrument was said to have moved."""
    joints, points = (values[:40].copy() for values in arm)
    points[24:] = points[23]
    with refused("implausible-readings", "16 of 40", "not read again") as caught:
        lc.init({**of(joints, NAMES), **of(points, "xyz")}, dh=dh(tmp_path))
    assert caught.value.options[0] == "--exclude"


def test_zeros_of_a_lost_reflector_are_refused(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    lost = points.copy()
    lost[[5, 17]] = 0.0
    with refused("lost-reflector"):
        lc.init({**of(joints, NAMES), **of(lost, "xyz")}, dh=dh(tmp_path))


def test_files_with_the_same_columns_are_taken_together(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    columns = {**of(joints, NAMES), **of(points, "xyz")}
    half = len(joints) // 2
    parts = [{n: v[:half] for n, v in columns.items()}, {n: v[half:] for n, v in columns.items()}]
    made = lc.init(*parts, dh=dh(tmp_path))
    assert len(made.dataset) == len(joints)
    assert np.allclose(made.dataset["x"], points[:, 0])
    assert any("taken together" in words for words in made.remarks)


def test_a_column_of_two_files_is_named_by_its_file(tmp_path: Path, arm: Any) -> None:
    joints, points = arm
    ids = np.arange(len(joints))
    own, seen = {"pose": ids, **of(joints, NAMES)}, {"pose": ids, **of(points, "xyz")}
    made = lc.init(own, {**seen, "J2": joints[:, 1]}, dh=dh(tmp_path))
    assert made.rms < 1e-3
    made = lc.init(own, {**seen, "J2": joints[:, 2]}, dh=dh(tmp_path))
    assert np.allclose(made.dataset["J2"], joints[:, 1])
    assert any("take no part: J2 (file 2)" in words for words in made.remarks)


@pytest.mark.parametrize("alone", [True, False])
def test_a_row_per_reflector_becomes_a_row_per_pose(
    tmp_path: Path, camera: Any, alone: bool
) -> None:
    joints, seen = camera
    here = seen[:, :3, 3]
    other = here + seen[:, :3, :3] @ np.array([0.1, -0.05, 0.02])
    ids = [f"P{i}" for i in range(len(joints)) for _ in range(2)]
    rows = np.stack([here, other], axis=1).reshape(-1, 3)[:-1]
    long = {"pose": ids[:-1], "target": ["A", "B"] * (len(joints) - 1) + ["A"], **of(rows, "xyz")}
    own = of(joints, NAMES)
    if alone:
        files = [table(tmp_path / "a.csv", {**long, **of(joints.repeat(2, axis=0)[:-1], NAMES)})]
    else:
        files = [
            table(tmp_path / "a.csv", long),
            table(tmp_path / "b.csv", {"pose": ids[::2], **own}),
        ]
    made = lc.init(*files, dh=dh(tmp_path), out=tmp_path / "out")
    assert len(made.dataset) == len(joints)
    assert np.allclose(made.dataset["y_1"], here[:, 1], atol=1e-8)
    assert np.isnan(made.dataset["y_2"]).sum() == 1
    assert_gives_the_noise_back_twice(tmp_path / "out")


def assert_gives_the_noise_back_twice(folder: Path) -> None:
    found = lc.calibrate(folder / "project.toml", method="least-squares")
    assert found.converged
    assert found.accuracy_after is not None
    assert found.accuracy_after.rms < 3.0 * NOISE


def test_the_sheet_with_the_readings_is_taken(tmp_path: Path, arm: Any) -> None:
    import xlsxwriter

    joints, points = arm
    path = tmp_path / "a.xlsx"
    with xlsxwriter.Workbook(str(path)) as book:
        book.add_worksheet("Notes").write(0, 0, "measured on Monday")
        sheet = book.add_worksheet("Data")
        sheet.write_row(0, 0, [*NAMES, "x", "y", "z"])
        for i, row in enumerate(np.hstack([joints, points]), 1):
            sheet.write_row(i, 0, row)
    made = lc.init(path, dh=dh(tmp_path), out=tmp_path / "out")
    assert 'sheet = "Data"' in made.text
    with xlsxwriter.Workbook(str(path)) as book:
        book.add_worksheet("Notes").write(0, 0, "measured on Monday")
    with refused("no-data", "Notes"):
        lc.init(path, dh=dh(tmp_path))


def test_of_several_sheets_the_large_one_is_read_and_equal_ones_are_named(
    tmp_path: Path, arm: Any
) -> None:
    import xlsxwriter

    rows = np.hstack(arm)

    def book(few: int) -> Path:
        path = tmp_path / f"{few}.xlsx"
        with xlsxwriter.Workbook(str(path)) as made:
            for name, number in (("Test", few), ("Data", len(rows))):
                sheet = made.add_worksheet(name)
                sheet.write_row(0, 0, [*NAMES, "x", "y", "z"])
                for i, row in enumerate(rows[:number], 1):
                    sheet.write_row(i, 0, row)
        return path

    made = lc.init(book(10), dh=dh(tmp_path), out=tmp_path / "a")
    assert 'sheet = "Data"' in made.text
    assert any("'Test' (10 rows)" in words for words in made.remarks)
    alike = book(len(rows))
    with refused("missing-key", "'Test'", "'Data'", "--sheet"):
        lc.init(alike, dh=dh(tmp_path))
    made = lc.init(alike, dh=dh(tmp_path), out=tmp_path / "b", sheet="Test")
    assert 'sheet = "Test"' in made.text


def test_of_several_matlab_variables_one_is_named(tmp_path: Path, arm: Any) -> None:
    from scipy.io import savemat

    rows = np.hstack(arm)
    savemat(tmp_path / "a.mat", {"first": rows, "second": rows[:10]})
    with refused("wrong-file-type", "first", "second", "--sheet"):
        lc.init(tmp_path / "a.mat", dh=dh(tmp_path))
    made = lc.init(tmp_path / "a.mat", dh=dh(tmp_path), out=tmp_path / "out", sheet="first")
    assert 'variable = "first"' in made.text
    assert len(lc.load_dataset(tmp_path / "out" / "project.toml").dataset) == len(rows)


def test_a_joint_that_counts_from_another_zero_is_named(tmp_path: Path, arm: Any) -> None:
    joints, points = (values[:48] for values in arm)
    turned = joints + np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    with refused("implausible-readings", "J2", "-90 deg"):
        lc.init({**of(turned, NAMES), **of(points, "xyz")}, dh=dh(tmp_path))


def test_a_guessed_mounting_is_wide_and_a_weak_set_keeps_all_candidates(
    tmp_path: Path, arm: Any
) -> None:
    """Poses of a corner determine where the reflector is to centimetres only: the default call
    compares models that give way too, and loses nothing by not knowing the drawing."""
    joints, _ = arm
    near = joints[:1] + 0.15 * (joints - joints.mean(axis=0))[:40]
    points = dh_arm.seen(near, sd=NOISE)[:, :3, 3]
    made = lc.init({**of(near, NAMES), **of(points, ["x", "y", "z"])}, dh=dh(tmp_path))
    for axis in "xyz":
        target = made.mechanism.parameters[f"tool_{axis}"]
        assert target.prior_sd == 0.2
        assert abs(target.nominal) < 0.5
    assert "structure" not in made.text
    result = lc.calibrate(made.mechanism, made.dataset, noise=made.noise)
    assert result.chosen is not None
    assert {"implicit-loop", "implicit-loop with model error"} <= {
        c.name for c in result.chosen.over
    }
    assert result.verdict is not None
    assert result.verdict.sound.passed is not False


NARROW = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])


@pytest.mark.parametrize(
    ("moved", "count", "weak"),
    [
        (np.ones(6), 60, False),
        (np.ones(6), 20, False),
        (np.full(6, 0.5), 40, False),
        (np.full(6, 0.04), 60, True),
        (NARROW, 60, True),
        (NARROW[::-1], 60, True),
    ],
)
def test_poses_are_called_worse_than_the_drawing_where_they_are(
    moved: np.ndarray, count: int, weak: bool, tmp_path: Path
) -> None:
    joints = moved * dh_arm.poses(count)
    made = lc.init({**of(joints, NAMES), **of(points_of(joints), "xyz")}, dh=dh(tmp_path))
    said = [words for words in made.remarks if "worse than its drawing" in words]
    assert bool(said) is weak
    if weak:
        still = [name for name, share in zip(NAMES, moved, strict=True) if share < 0.5]
        assert [name for name in NAMES if f"{name} -" in said[0]] == still
        assert re.search(r"at least \d+ poses", said[0])
    # over the working range, by the true machine
    everywhere = np.random.default_rng(8).uniform(-1.5, 1.5, (100, 6))
    true = points_of(everywhere, sd=0.0)
    data = lc.Dataset.from_arrays({**of(everywhere, NAMES), **of(true, "xyz")})
    found = lc.calibrate(made, method="least-squares").predict(data).outputs
    off = np.square(np.array([found[axis] for axis in "xyz"]).T - true).sum(axis=1)
    parameters = made.mechanism.parameters
    drawn = parameters.with_fixed([p.name for p in parameters if p.dimension])
    placed = lc.calibrate(made.mechanism.with_parameters(drawn), data, method="least-squares")
    assert placed.accuracy_after is not None
    assert (np.sqrt(off.mean()) > placed.accuracy_after.rms) is np.bool_(weak)


@pytest.mark.parametrize(
    ("rows", "spans"),
    [
        (
            ["400,300,0,0", "300,0,180,0", "0,0,0,0,prismatic", "50,0,0,0"],
            [(-2.0, 2.0), (-2.0, 2.0), (0.0, 0.2), (-2.0, 2.0)],
        ),
        (
            [
                *("0,0,-90,0,prismatic", "200,400,-90,0", "600,0,0,-90", "100,0,-90,0"),
                *("0,640,90,0", "0,0,-90,0", "0,200,0,0"),
            ],
            [(0.0, 2.0), *6 * [(-1.4, 1.4)]],
        ),
    ],
    ids=["SCARA", "rail"],
)
def test_fifteen_good_poses_of_an_arm_with_a_slide_are_not_called_worse_than_its_drawing(
    rows: list[str], spans: list[tuple[float, float]], tmp_path: Path
) -> None:
    path = tmp_path / "dh.csv"
    kinds = [row if row.endswith("prismatic") else f"{row},revolute" for row in rows]
    lines = [f"j{i},{row}" for i, row in enumerate(kinds, 1)]
    path.write_text("\n".join(["joint,a [mm],d [mm],alpha [deg],theta [deg],type", *lines, ""]))
    machine = mechanism_from_data(dict(dh_robot(path, ()).table), "project.toml")
    names = [*dict.fromkeys(step.joint for step in machine.chain if step.joint)]
    joints = lc.random_poses(dict(zip(names, spans, strict=True)), 15, seed=2)
    truth = {"tool_x": 0.05, "tool_y": 0.05, "tool_z": 0.05}
    truth = {p.name: truth.get(p.name, p.nominal) for p in machine.parameters}
    made = lc.simulate(machine, joints, noise=lc.Noise({"*": 3e-5}), seed=1, truth=truth).dataset
    began = lc.init({q: np.array(made[q]) for q in [*names, *"xyz"]}, dh=path)
    assert not [words for words in began.remarks if "worse than its drawing" in words]


def points_of(joints: np.ndarray, sd: float = NOISE) -> np.ndarray:
    return dh_arm.seen(joints, sd=sd)[:, :3, 3]
