"""Layouts of real files: what was measured is read, what was commanded or computed is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.layouts import (
    LAYOUTS,
    World,
    begin,
    described,
    frames,
    joints,
    next_command,
    of,
    written,
    xyz,
)
from loopcal.errors import InputError
from loopcal.files.project.project_data import read_new_readings
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.headers import heading
from loopcal.files.recognition.joint_sets import joint_columns
from loopcal.files.recognition.sources import listed_columns
from tests.bags import motion
from tests.refusals import refused

POSES = 36


def begun(name: str, folder: Path) -> tuple[World, lc.InitialProject]:
    """The project of a layout."""
    robot, maker = LAYOUTS[name]
    world = World(robot, 1)
    described(world, folder)
    case = maker(world, folder)
    readings = [folder / f for f in case.files]
    if "--urdf" in case.options:
        return world, lc.init(*readings, urdf=folder / "robot.urdf")
    return world, lc.init(*readings, dh=folder / "dh.csv")


def joint_readings(made: lc.InitialProject) -> np.ndarray:
    chain = made.mechanism.chain
    names = dict.fromkeys(step.joint for step in chain if step.joint)
    return np.column_stack([made.dataset[name] for name in names])


@pytest.mark.parametrize(
    "name",
    [
        "J_cmd, J_act",
        "X_soll, X_ist",
        "UR log: target_q, actual_q, actual_qd, TCP",
        "E1 moves a rail",
        "fingers of a gripper beside the joints of a URDF",
        "a modified table under plain headers",
        "a list of joints in one column",
        "KRL: {A1 12.3, A2 ...} in one column",
        "Japanese, Shift-JIS",
        "Fanuc: positions of an .LS",
        "RAPID: jointtargets of a .mod",
        "rostopic echo: YAML",
        "MATLAB: two matrices beside a calibration matrix",
        "PolyWorks: a row per coordinate",
        "a sheet with a title, merged headers and units below",
        "pandas: index and two levels of columns",
        "Staubli: command and feedback of each joint in turn",
        "Doosan: actual and target positions, tool position, alphabetical",
        "FARO CAM2: quoted names, no header, blanks",
        "KUKA RSI: a line of XML per pose",
        "units within the cells: 12.345°, 1234.5 mm",
        "a sheet with a column per pose",
    ],
)
def test_what_was_measured_is_read(tmp_path: Path, name: str) -> None:
    world, made = begun(name, tmp_path)
    assert np.allclose(joint_readings(made), world.read, atol=1e-6)
    (fit,) = made.fits.values()
    assert np.allclose(made.dataset["x"], world.points[:, 0], atol=1e-6)
    assert fit.rms < 3e-3


@pytest.mark.parametrize(
    "name",
    ["Distance, Azimut, Élévation", "a total station: Hz and V in degrees, minutes, seconds"],
)
def test_a_length_beside_two_angles_is_a_tracker(tmp_path: Path, name: str) -> None:
    _, made = begun(name, tmp_path)
    assert list(made.fits) == ["tracker"]


def test_an_angle_that_is_no_number_is_no_text_to_pass_over(tmp_path: Path) -> None:
    world = World("six", 2)
    described(world, tmp_path)
    seen = {"Hz": ["12-30-45"] * POSES, "V": ["80-10-10"] * POSES, "D [m]": world.points[:, 0]}
    written(tmp_path / "a.csv", {**joints(world), **seen})
    with refused("invalid-number", "row 2, column 'Hz'", "12-30-45"):
        lc.init(tmp_path / "a.csv", dh=tmp_path / "dh.csv")


def test_coordinates_in_a_file_of_their_own_are_no_turn(tmp_path: Path) -> None:
    _, made = begun("Epson: a .pts of computed points beside joints and a tracker", tmp_path)
    assert list(made.fits) == ["point"]


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("rostopic echo -p, two files by time", np.ones(POSES, dtype=bool)),
        ("two files without ids, two rows lost", ~np.isin(np.arange(POSES), [9, 22])),
        (
            "two files without ids, a row lost in every part",
            ~np.isin(np.arange(POSES), [4, 19, 31]),
        ),
        ("a few numeric ids measured twice", np.ones(POSES, dtype=bool)),
        ("a file of JSON per pose", np.ones(POSES, dtype=bool)),
        ("a list of YAML", np.ones(POSES, dtype=bool)),
        (
            "RAPID beside SpatialAnalyzer: Collection::Group::Point without a header, two points "
            "lost",
            ~np.isin(np.arange(POSES), [9, 22]),
        ),
    ],
)
def test_files_of_unlike_lengths_are_joined(tmp_path: Path, name: str, rows: np.ndarray) -> None:
    world, made = begun(name, tmp_path)
    assert np.allclose(joint_readings(made), world.read[rows], atol=1e-6)
    assert np.allclose(made.dataset["x"], world.points[rows, 0], atol=1e-6)


def test_each_station_may_count_its_own_poses(tmp_path: Path) -> None:
    world, made = begun("a column of stations, each of which counts its own poses", tmp_path)
    assert np.allclose(joint_readings(made), world.read, atol=1e-6)
    first = np.arange(POSES) < POSES // 2
    assert np.allclose(made.dataset["x_1"][first], world.points[first, 0], atol=1e-6)
    assert np.isnan(made.dataset["x_1"][~first]).all()
    assert np.allclose(made.dataset["x_2"][~first], world.elsewhere[~first, 0], atol=1e-6)


def test_numbers_in_ids_join_files_whose_rows_are_in_another_order(tmp_path: Path) -> None:
    name = "ids P01, and numbers ahead of points without a header, two rows lost"
    world, made = begun(name, tmp_path)
    rows = [int(pose.removeprefix("P")) - 1 for pose in made.dataset.poses]
    assert sorted(rows) == [i for i in range(POSES) if i not in (9, 22)]
    assert np.allclose(joint_readings(made), world.read[rows], atol=1e-6)
    assert np.allclose(made.dataset["x"], world.points[rows, 0], atol=1e-6)


def test_points_that_a_controller_computed_are_no_measurement(tmp_path: Path) -> None:
    world = World("six", 2)
    described(world, tmp_path)
    written(tmp_path / "a.csv", {**joints(world), **xyz("{}", world.tcp)})
    with refused("implausible-readings", "x, y, z"):
        lc.init(tmp_path / "a.csv", dh=tmp_path / "dh.csv")


@pytest.mark.parametrize(
    ("name", "missing"),
    [
        ("OptiTrack: five rows of headers", [7]),
        ("NDI Polaris: a number for what is missing", [4, 17, 30]),
    ],
)
def test_poses_that_were_not_seen_are_blank(tmp_path: Path, name: str, missing: list[int]) -> None:
    world, made = begun(name, tmp_path)
    blank = np.isnan(made.dataset["x"])
    assert np.flatnonzero(blank).tolist() == missing
    assert np.allclose(made.dataset["x"][~blank], world.points[~blank, 0], atol=1e-6)


def test_joints_that_nothing_distinguishes_are_asked_for(tmp_path: Path) -> None:
    world = World("six", 1)
    described(world, tmp_path)
    other = world.read + np.random.default_rng(0).normal(0.0, 2e-5, world.read.shape)
    columns = {**joints(world, "J{}_a"), **joints(world, "J{}_b", other), **xyz("{}", world.points)}
    path = tmp_path / written(tmp_path / "a.csv", columns)
    with pytest.raises(InputError) as caught:
        lc.init(path, dh=tmp_path / "dh.csv")
    assert caught.value.options[0] == "--joints"
    made = lc.init(path, dh=tmp_path / "dh.csv", joints=caught.value.options[1])
    assert len(made.dataset) == POSES
    named = lc.init(path, dh=tmp_path / "dh.csv", leave_out="J*_b")
    assert np.allclose(joint_readings(named), world.read, atol=1e-6)


@pytest.mark.parametrize("name", ["z", "z1", "height_2"])
def test_one_coordinate_alone_is_no_wire(tmp_path: Path, name: str) -> None:
    world = World("six", 1)
    described(world, tmp_path)
    columns = {**joints(world, "J{}"), name: world.points[:, 2]}
    with refused("missing-column", f"{name!r} alone places no point", "in a mechanism file"):
        lc.init(tmp_path / written(tmp_path / "a.csv", columns), dh=tmp_path / "dh.csv")


def begun_by_the_next_command(name: str, folder: Path) -> tuple[World, lc.Project]:
    """A layout that is refused, and the project that the command in its refusal makes."""
    robot, maker = LAYOUTS[name]
    world = World(robot, 1)
    described(world, folder)
    maker(world, folder)
    code, printed = begin(["data.csv", "--dh", "dh.csv", "--out", "out"], folder)
    assert code == 3
    command = next_command(printed)
    assert command is not None
    assert begin(command[1:], folder)[0] == 0
    return world, lc.read_project(folder / "out" / "project.toml")


@pytest.mark.parametrize(
    ("name", "sign", "made"),
    [
        # The table of the robot turns a joint round, so it stays as the controller counts it.
        ("one joint reversed", -1.0, ("J4", "\ndirection = -1\n")),
        # Files of later days are read by the same expression.
        (
            "J3 counts from the horizon (Fanuc)",
            1.0,
            ("theta_4", 'theta_3 = { column = "J3-J2", unit = "deg" }'),
        ),
    ],
)
def test_the_next_command_of_a_refusal_goes_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    sign: float,
    made: tuple[str, str],
) -> None:
    monkeypatch.chdir(tmp_path)
    world, project = begun_by_the_next_command(name, tmp_path)
    joint, line = made
    assert np.allclose(lc.load_dataset(project).dataset[joint], sign * world.read[:, 3], atol=1e-6)
    assert line in Path("out/project.toml").read_text()


@pytest.mark.parametrize(
    "name", ["two joints under each other's headers", "degrees under headers of radians"]
)
def test_a_mistake_in_the_headers_is_read_by_the_next_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    world, project = begun_by_the_next_command(name, tmp_path)
    read = lc.load_dataset(project).dataset
    joints = [q for q in read.readings if q not in "xyz"]
    assert np.allclose([read[q] for q in joints], world.read.T, atol=1e-6)
    # A file of another day has the same mistake.
    later = read_new_readings(("data.csv",), project.inputs, project.mechanism)
    assert np.allclose([later[q] for q in joints], world.read.T, atol=1e-6)


def test_lists_in_cells_become_columns() -> None:
    made = listed_columns(heading("pose [mm]"), ["{'x': 1, 'y': -2e1}", "{'x': 3.5, 'y': .4}"])
    assert [(h.stem, h.unit, v.tolist()) for h, v in made] == [
        ("pose_x", "mm", [1.0, 3.5]),
        ("pose_y", "mm", [-20.0, 0.4]),
    ]
    assert [h.stem for h, _ in listed_columns(heading("q"), ["[1, 2]", "(3 4)"])] == ["q_1", "q_2"]
    for cells in (["[1, 2]", "[3]"], ["[1]", "[2]"], ["1, 2", "3, 4"], ["{A 1, A 2}"] * 2, []):
        assert listed_columns(heading("q"), cells) == []


def test_the_table_of_the_robot_may_stand_among_the_readings(tmp_path: Path) -> None:
    world = World("six", 1)
    described(world, tmp_path)
    written(tmp_path / "a.csv", {**joints(world), **xyz("{}", world.points)})
    made = lc.init(tmp_path / "a.csv", tmp_path / "dh.csv")
    assert np.allclose(joint_readings(made), world.read, atol=1e-6)
    with refused("no-data", "no readings"):
        lc.init(tmp_path / "dh.csv", dh=tmp_path / "dh.csv")


def test_expressions_of_columns() -> None:
    columns = [Field(0, i, heading(f"J{i + 1} [deg]"), np.array([10.0 * i, 1.0])) for i in range(4)]
    made = joint_columns(columns, "J1 [deg], -J2, J3 + J2 - 90, J4*0.5")
    assert [f.values.tolist() for f in made] == [[0, 1], [-10, -1], [-60, -88], [15, 0.5]]
    assert [f.unit for f in made] == ["deg"] * 4
    # A factor belongs to its own term.
    made = joint_columns(columns, "J2+J3*0.5,-J2*1.5-J3*0.5+3")
    assert [f.values.tolist() for f in made] == [[20, 1.5], [-22, 1]]
    with refused("unknown-name", "J9"):
        joint_columns(columns, "J1,J9")


def test_signs_of_a_maker_are_told_from_a_mirrored_frame(tmp_path: Path) -> None:
    """A robot that counts joints 1, 4 and 6 the other way round moves as in a mirror, beside its
    own controller and a tracker. The ids stand under names of the makers, the table of the robot
    below a title, the sds beside the points of the second file."""
    world = World("six", 3)
    flip = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    ids = [f"P{i + 1}" for i in range(POSES)]
    robot = {"Pos": ids, **joints(world, "A{}", world.read * flip), **xyz("{}", world.tcp, "XYZ")}
    seen = {"Group": ["A"] * POSES, "Point": ids, **xyz("{}", world.points, "XYZ")}
    sds = {f"U{a}": np.full(POSES, 0.03) for a in "xyz"}
    written(tmp_path / "robot.csv", robot)
    written(tmp_path / "tracker.csv", {**seen, **sds})
    described(world, tmp_path)
    table = (tmp_path / "dh.csv").read_text()
    (tmp_path / "dh.csv").write_text(f"Datasheet of the arm\n\n{table}")
    paths = (tmp_path / "robot.csv", tmp_path / "tracker.csv")
    with pytest.raises(InputError, match="A1, A4, A6 count the other way round") as caught:
        lc.init(*paths, dh=tmp_path / "dh.csv")
    option, columns = caught.value.options
    assert (option, columns) == ("--joints", "-A1,A2,A3,-A4,A5,-A6")
    made = lc.init(*paths, dh=tmp_path / "dh.csv", joints=columns, out=tmp_path / "project")
    assert np.allclose(joint_readings(made), world.read * flip, atol=1e-6)
    assert made.text.count("\ndirection = -1") == 3
    assert all(fit.rms < 3e-3 for fit in made.fits.values())
    np.testing.assert_allclose(made.dataset.sds["x"], 3e-5)
    loaded = lc.load_dataset(lc.read_project(tmp_path / "project" / "project.toml"))
    np.testing.assert_allclose(loaded.dataset.sds["x"], 3e-5)
    assert "Alternative" not in made.text


def test_a_log_of_a_controller_beside_a_tracker(tmp_path: Path) -> None:
    """Commanded and actual joints, velocities, the controller's own pose and two times; the joints
    that were read are taken, the tracker's delay is estimated by the stamps."""
    world = World("ur", 5, poses=24)
    t, s = np.arange(0.0, 36.0, 0.02), np.arange(0.0, 36.0, 0.04)
    actual = motion(world.q, t) + world.rng.normal(0, 2e-5, (len(t), 6))
    target = motion(world.command, t)
    T = frames(world.drawn, world.slides, actual)
    numbers = range(6)
    log = {
        "timestamp": 100.0 + t,
        **of((f"target_q_{i}" for i in numbers), target),
        **of((f"actual_q_{i}" for i in numbers), actual),
        **of((f"actual_qd_{i}" for i in numbers), np.gradient(actual, t, axis=0)),
        **of(
            (f"actual_TCP_pose_{i}" for i in numbers),
            np.hstack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()]),
        ),
    }
    points = world.target(motion(world.q, s - 0.025)) + world.rng.normal(0, 3e-5, (len(s), 3))
    stamps = {"time": 100.7 + s, "header.stamp": 100.0 + s}
    written(tmp_path / "log.csv", {"stamp": log.pop("timestamp"), **log}, sep=" ", digits=8)
    written(tmp_path / "tracker.csv", {**stamps, **xyz("{} [mm]", points)})
    described(world, tmp_path)
    made = lc.init(tmp_path / "log.csv", tmp_path / "tracker.csv", dh=tmp_path / "dh.csv")
    assert "The joints are actual_q_0" in made.text
    assert len(made.fits) == 1
    assert not any("target" in name for name in made.dataset.readings)
    (delay,) = made.delays
    assert delay.sd < 2e-4
    assert abs(delay.value - 0.025) < 4.0 * delay.sd


def test_words_beside_the_readings(tmp_path: Path) -> None:
    world = World("six", 1)
    described(world, tmp_path)
    columns = {**joints(world, "Csukló {} [fok]"), **xyz("{} [mm]", world.points)}
    path = tmp_path / written(tmp_path / "a.csv", columns)
    (tmp_path / "loopcal-words.toml").write_text(
        '[words]\n"csukló" = "joint"\n"fok" = "deg"\n', "utf-8"
    )
    made = lc.init(path, dh=tmp_path / "dh.csv")
    assert not any("Inferred" in words for words in made.remarks)
    (tmp_path / "loopcal-words.toml").write_text('[words]\n"fok" = 1\n', "utf-8")
    with refused("invalid-value", "loopcal-words.toml"):
        lc.init(path, dh=tmp_path / "dh.csv")


def test_a_unit_that_is_none_is_named_and_the_next_command_works(tmp_path: Path) -> None:
    world = World("six", 2)
    described(world, tmp_path)
    columns = {**joints(world, "J{} [deg]"), **xyz("{} [mm]", world.points)}
    columns["J1 [furlong]"] = columns.pop("J1 [deg]")
    written(tmp_path / "a.csv", {name: columns[name] for name in sorted(columns)})
    code, said = begin(["a.csv", "--urdf", "robot.urdf"], tmp_path)
    assert code == 3
    assert "'furlong' in the header 'J1 [furlong]' is no known unit" in said
    command = next_command(said)
    assert command is not None
    assert "--joints" in command
    assert begin(command[1:], tmp_path)[0] == 0
