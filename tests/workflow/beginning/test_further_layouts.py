"""Layouts of real files that were refused, or read with less than they hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.layouts import World, described, ids, joints, of, polar, written, xyz
from loopcal.files.project.project_data import read_new_readings
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.checking import run_prediction
from loopcal.workflow.readings import new_readings
from tests.refusals import refused

Maker = Callable[[World, Path], list[str]]
DEGREES = np.pi / 180
AWAY, TARGET = np.array([2400.0, 900.0, 300.0]), np.array([40.0, -25.0, 130.0])


def tracker(w: World, folder: Path, rows: Any = slice(None)) -> str:
    columns = {"Name": ids(w, "p{}"), **xyz("{}", w.points, "XYZ")}
    return written(folder / "points.csv", {k: np.array(v)[rows] for k, v in columns.items()})


def turns(w: World, folder: Path) -> list[str]:
    columns = {
        "Name": ids(w, "p{}"),
        **of((f"A{i} [rev]" for i in range(1, 7)), w.read / 2 / np.pi),
    }
    return [written(folder / "a.csv", columns, digits=9), tracker(w, folder)]


def unstated_arcminutes(w: World, folder: Path) -> list[str]:
    columns = {"Name": ids(w, "p{}"), **of((f"J{i}" for i in range(1, 7)), w.read / DEGREES * 60)}
    return [written(folder / "a.csv", columns), tracker(w, folder)]


def measured_twice(w: World, folder: Path) -> list[str]:
    lines = ["// SpatialAnalyzer", "// Group, Point, X, Y, Z"]
    for i, point in enumerate(1e3 * w.points):
        text = ", ".join(f"{v:.6f}" for v in point)
        lines += [f"Robot::p{i + 1}, {text}"] * (2 if i in (4, 9) else 1)
    (folder / "sa.txt").write_text("\n".join(lines), "utf-8")
    return [written(folder / "a.csv", {"Point": ids(w, "p{}"), **joints(w)}), "sa.txt"]


def jointtargets_in_a_log(w: World, folder: Path) -> list[str]:
    nines = ",".join(["9E+09"] * 6)
    lines = [
        f"2024-03-01 10:{i:02d}:00 p{i + 1} [[{','.join(f'{v:.6f}' for v in q)}],[{nines}]]"
        for i, q in enumerate(w.shown(w.read))
    ]
    (folder / "a.log").write_text("\n".join(lines) + "\n", "utf-8")
    return ["a.log", tracker(w, folder)]


def jointtargets_in_tens(w: World, folder: Path) -> list[str]:
    nines = ",".join(["9E9"] * 6)
    lines = [
        f"  CONST jointtarget p{10 * i}:=[[{','.join(f'{v:.6f}' for v in q)}],[{nines}]];"
        for i, q in enumerate(w.shown(w.read), 1)
    ]
    text = "\n".join(["MODULE Poses", *lines, "ENDMODULE", ""])
    (folder / "a.mod").write_text(text, "utf-8")
    return ["a.mod", tracker(w, folder, slice(None, None, -1))]


def a_file_per_column(w: World, folder: Path) -> list[str]:
    columns = {**joints(w), **xyz("{}", w.points, "XYZ")}
    return [
        written(folder / f"{name}.csv", {"point": ids(w), "value": values})
        for name, values in columns.items()
    ]


def unit_vectors(w: World, folder: Path) -> list[str]:
    names = [f"{a}{i}" for a in "XYZ" for i in "ijk"]
    axes = of(names, w.turns.transpose(0, 2, 1).reshape(-1, 9))
    columns = {**joints(w), **xyz("{}", w.points, "XYZ"), **axes}
    return [written(folder / "a.csv", columns, digits=9)]


def structs(w: World, folder: Path) -> list[str]:
    data = np.zeros(len(w.q), dtype=[("name", "O"), ("q", "O"), ("p", "O")])
    for i in range(len(w.q)):
        data[i] = (f"P{i}", w.read[i], 1e3 * w.points[i])
    savemat(folder / "data.mat", {"data": data, "info": "cell 3"})
    return ["data.mat"]


def structs_in_a_struct(w: World, folder: Path) -> list[str]:
    data = {"robot": {"q": w.read, "serial": "A7"}, "tracker": {"xyz": w.points, "height": 1.2}}
    savemat(folder / "data.mat", {"data": data, "version": 3.0})
    return ["data.mat"]


def expanded_uncertainties(w: World, folder: Path) -> list[str]:
    far = np.linspace(50.0, 56.0, len(w.q))
    sds = {
        f"U{a}95_um": values for a, values in zip("xyz", (far, 0.0 * far + 40.0, far), strict=True)
    }
    steady = {f"quality_{a}": 0.0 * far + 1.0 for a in "xyz"}
    columns = {**joints(w), **xyz("{}", w.points, "XYZ"), **sds, **steady}
    return [written(folder / "a.csv", columns)]


def a_header_again(w: World, folder: Path) -> list[str]:
    name = written(folder / "a.csv", {**joints(w), **xyz("{}", w.points, "XYZ")})
    head, *rows = (folder / name).read_text("utf-8").splitlines()
    lines = ["Run 7", "", head, *rows[:9], "", "# a break", head, *rows[9:]]
    (folder / name).write_text("\n".join(lines) + "\n", "utf-8")
    return [name]


def commanded_ahead(w: World, folder: Path) -> list[str]:
    command = {"Name": ids(w, "p{}"), **joints(w, values=w.command)}
    written(folder / "a.csv", command)
    return ["a.csv", written(folder / "b.csv", {**command, **joints(w)}), tracker(w, folder)]


def one_name_twice(w: World, folder: Path) -> list[str]:
    every = {"Name": ids(w, "p{}"), **joints(w, "J{}x", w.command), **joints(w)}
    name = written(folder / "a.csv", every)
    text = (folder / name).read_text("utf-8")
    head, rest = text.split("\n", 1)
    (folder / name).write_text(head.replace("x", "") + "\n" + rest, "utf-8")
    return [name, tracker(w, folder)]


def nominal_and_errors(w: World, folder: Path) -> list[str]:
    off = w.points - w.points.mean(axis=0)
    errors = off - off[::-1] * 1e-3 - off
    columns = {**joints(w), **xyz("{}r", w.points, "XYZ"), **xyz("e{}", errors, "XYZ")}
    return [written(folder / "a.csv", columns)]


def matrices_below_each_other(w: World, folder: Path) -> list[str]:
    T = np.tile(np.eye(4), (len(w.q), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = w.turns, 1e3 * w.points
    blocks = ["\n".join(" ".join(f"{v:.9f}" for v in row) for row in one) for one in T]
    text = "".join(f"Pose {i}\n{block}\n\n" for i, block in enumerate(blocks, 1))
    (folder / "poses.txt").write_text(text, "utf-8")
    return [written(folder / "a.csv", {"Pose": ids(w, "{}"), **joints(w)}), "poses.txt"]


def shots_named_after_their_pose(w: World, folder: Path) -> list[str]:
    off = np.random.default_rng(1).normal(0.0, 1e-5, (2, *w.points.shape))
    shots = np.stack([w.points + off[0], w.points + off[1], w.points - off[0] - off[1]], axis=1)
    names = [f"p{i + 1}_t{k + 1}" for i in range(len(w.q)) for k in range(3)]
    columns = {"Name": names, **xyz("{}", shots.reshape(-1, 3), "XYZ")}
    order = np.random.default_rng(2).permutation(len(names))
    columns = {k: np.array(v)[order] for k, v in columns.items()}
    named = {"Name": ids(w, "p{}"), **joints(w)}
    return [written(folder / "a.csv", named), written(folder / "points.csv", columns, digits=9)]


def a_first_column_called_by_the_mark_of_comments(w: World, folder: Path) -> list[str]:
    columns = {"#": ids(w, "{}"), **joints(w), **xyz("{}", w.points, "XYZ")}
    return [written(folder / "a.csv", columns)]


def turns_of_a_kawasaki(w: World, folder: Path) -> list[str]:
    angles = Rotation.from_matrix(w.turns).as_euler("ZYZ", degrees=True)
    columns = {**joints(w), **xyz("{}", w.points, "XYZ"), **of("OAT", angles)}
    return [written(folder / "a.csv", columns)]


@pytest.mark.parametrize(
    "maker",
    [
        shots_named_after_their_pose,
        a_first_column_called_by_the_mark_of_comments,
        turns_of_a_kawasaki,
        matrices_below_each_other,
        commanded_ahead,
        one_name_twice,
        nominal_and_errors,
        turns,
        unstated_arcminutes,
        measured_twice,
        jointtargets_in_a_log,
        jointtargets_in_tens,
        a_file_per_column,
        unit_vectors,
        structs,
        structs_in_a_struct,
        expanded_uncertainties,
        a_header_again,
    ],
)
def test_what_was_measured_is_read(tmp_path: Path, maker: Maker) -> None:
    world = World("six", 8)
    described(world, tmp_path)
    files = maker(world, tmp_path)
    lc.init(*(tmp_path / f for f in files), dh=tmp_path / "dh.csv", out=tmp_path / "cal")
    project = lc.read_project(tmp_path / "cal" / "project.toml")
    read = lc.load_dataset(project).dataset
    names = list(project.mechanism.joints)
    assert np.allclose(np.column_stack([read[n] for n in names]), world.read, atol=1e-6)
    assert np.allclose(np.column_stack([read[n] for n in "xyz"]), world.points, atol=1e-6)
    forms = [family.form for family in project.mechanism.families]
    six = maker in (unit_vectors, matrices_below_each_other, turns_of_a_kawasaki)
    assert forms == ["pose" if six else "point"]


RUSSIAN = ("№ точки", "Температура", "Ось {} (град)", "{} заданное (мм)", "{} изм. (мм)")
TURKISH = ("Nokta", "Sıcaklık", "Eksen {} (derece)", "{} hedef (mm)", "{} ölçülen (mm)")


@pytest.mark.parametrize("words", [RUSSIAN, TURKISH])
def test_headers_in_russian_and_turkish(tmp_path: Path, words: tuple[str, ...]) -> None:
    world = World("six", 14)
    described(world, tmp_path)
    pose, warmth, joint, aim, seen = words
    columns = {
        pose: ids(world, "{}"),
        warmth: world.rng.uniform(19.0, 24.0, len(world.q)),
        **joints(world, joint),
        **xyz(aim, world.commanded, "XYZ"),
        **xyz(seen, world.points, "XYZ"),
    }
    written(tmp_path / "a.csv", columns, sep=";", decimal=",")
    made = lc.init(tmp_path / "a.csv", dh=tmp_path / "dh.csv")
    assert "temperature" in made.dataset.readings
    assert made.dataset.poses[:2] == ("1", "2")
    assert np.allclose(made.dataset["x"], world.points[:, 0], atol=1e-8)


def test_a_log_at_ten_times_a_second_beside_points_by_time(tmp_path: Path) -> None:
    world = World("ur", 9)
    described(world, tmp_path)
    gone, rows, times, stood = 7, list[np.ndarray](), list[float](), list[float]()
    for i, q in enumerate(world.q):
        before = world.q[i - 1] if i else q
        for share in (*np.linspace(0.1, 0.9, 8), *np.ones(12)):
            rows.append(before + share * (q - before))
            times.append(100.0 + 0.1 * len(times))
        stood.append(times[-6] + 0.04)
    noise = np.random.default_rng(1).normal(0.0, 1e-6, (len(rows), 6))
    columns = of((f"actual_q_{i}" for i in range(6)), np.array(rows) + noise)
    written(tmp_path / "rtde.csv", {"timestamp": times, **columns}, sep=" ", digits=8)
    seen = np.arange(len(world.q)) != gone
    points = xyz("{} [mm]", world.points[seen])
    written(tmp_path / "tracker.csv", {"time [s]": np.array(stood)[seen], **points})
    made = lc.init(tmp_path / "rtde.csv", tmp_path / "tracker.csv", dh=tmp_path / "dh.csv")
    assert np.allclose(made.dataset["actual_q_0"], world.q[seen, 0], atol=1e-5)
    assert np.allclose(made.dataset["z"], world.points[seen, 2], atol=1e-6)


@pytest.mark.parametrize("name", ["Z [mm]", "Höhe [mm]", "z_meas"])
def test_one_coordinate_is_no_length_of_a_wire(tmp_path: Path, name: str) -> None:
    world = World("six", 10)
    described(world, tmp_path)
    written(tmp_path / "a.csv", {**joints(world, "J{} [deg]"), name: 1e3 * world.points[:, 2]})
    with refused("missing-column", name, "plane"):
        lc.init(tmp_path / "a.csv", dh=tmp_path / "dh.csv")


@pytest.mark.parametrize("names", ["J1 J2 J3 J4 J5 J6", "S L U R B T"])
def test_a_table_with_a_row_per_joint_is_no_readings(tmp_path: Path, names: str) -> None:
    """Its numbers had joined those of the poses, of which six were left."""
    world = World("six", 13)
    described(world, tmp_path)
    columns = {"no": [f"{i}" for i in range(1, len(world.q) + 1)], **joints(world)}
    written(tmp_path / "a.csv", {**columns, **xyz("{} [mm]", world.points)})
    written(tmp_path / "b.csv", {"joint": names.split(), "offset": np.arange(6.0)})
    with refused("mismatched-poses", "b.csv", "row per joint"):
        lc.init(tmp_path / "a.csv", tmp_path / "b.csv", dh=tmp_path / "dh.csv")


ROWS = ["1,0,0,-90,-90,p", "2,0,400,-90,-90,p", "3,0,600,0,0,p", "4,0,80,90,0,r", "5,0,30,0,0,r"]


def slides(folder: Path, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first joints of a machine tool in mm and deg, and measured points [mm]."""
    text = "\n".join(["joint,a [mm],d [mm],alpha [deg],theta [deg],type", *ROWS[:count]])
    (folder / "dh.csv").write_text(text, "utf-8")
    rng = np.random.default_rng(11)
    q = rng.uniform([0, 0, 0, -90, -170], [1200, 900, 600, 90, 170], (40, 5))
    T = np.eye(4)[None]
    for i in range(count):
        _, _, d, alpha, theta, kind = ROWS[i].split(",")
        step = np.tile(np.eye(4), (len(q), 1, 1))
        turn = float(theta) + (q[:, [i]] if kind == "r" else np.zeros((len(q), 1)))
        tilt = Rotation.from_euler("x", float(alpha), degrees=True)
        step[:, :3, :3] = (Rotation.from_euler("z", turn, degrees=True) * tilt).as_matrix()
        step[:, 2, 3] = float(d) + (q[:, i] if kind == "p" else 0.0)
        T = T @ step
    points = T[:, :3, 3] + T[:, :3, :3] @ TARGET
    S = Rotation.from_rotvec([0.1, -0.2, 0.7])
    return q[:, :count], S.apply(points) + AWAY + rng.normal(0, 0.02, points.shape)


def test_a_machine_is_about_as_long_as_it_travels(tmp_path: Path) -> None:
    q, points = slides(tmp_path, 5)
    columns = {**of("XYZBC", q), **of(["Xm", "Ym", "Zm"], points)}
    written(tmp_path / "nc.csv", columns)
    made = lc.init(tmp_path / "nc.csv", dh=tmp_path / "dh.csv")
    assert np.allclose(made.dataset["x"], 1e-3 * points[:, 0], atol=1e-8)


def test_points_of_a_turntable_are_about_as_far_apart_as_it_is_long(tmp_path: Path) -> None:
    """Two axes that turn fix no length: balls fitted in m, mm and inches, each in its own unit."""
    text = "a [mm],d [mm],alpha [deg],theta [deg]\n0,300,90,0\n0,50,0,0\n"
    (tmp_path / "dh.csv").write_text(text, "utf-8")
    rng = np.random.default_rng(26009)
    q = np.degrees(rng.uniform([-1.6, -3.1], [1.6, 3.1], (24, 2)))
    balls = [[100.0, 10.0, 50.0], [-50.0, 90.0, 50.0], [-60.0, -80.0, 90.0]]
    turn = Rotation.from_euler("ZXZ", [[a, 90.0, c] for a, c in q], degrees=True)
    arm = Rotation.from_euler("ZX", [[a, 90.0] for a, _ in q], degrees=True).apply([0, 0, 50.0])
    S = Rotation.from_rotvec([0.002, -0.001, 0.8])
    seen = np.stack([S.apply(arm + turn.apply(ball)) + AWAY for ball in balls], axis=1)
    seen += rng.normal(0.0, 0.01, seen.shape)
    each = {"Pos": np.repeat(np.arange(24.0), 3), "Ball": [f"K{k}" for k in (1, 2, 3)] * 24}
    columns = {**each, **of("AC", np.repeat(q, 3, axis=0)), **of("XYZ", seen.reshape(-1, 3))}
    written(tmp_path / "cmm.csv", columns)
    made = lc.init(tmp_path / "cmm.csv", dh=tmp_path / "dh.csv")
    read = np.column_stack([made.dataset[f"x_{k}"] for k in (1, 2, 3)])
    assert np.allclose(read, 1e-3 * seen[:, :, 0], atol=1e-8)


def test_a_robot_may_be_named_among_the_readings_and_by_its_option(tmp_path: Path) -> None:
    world = World("six", 10)
    described(world, tmp_path)
    files = [tmp_path / tracker(world, tmp_path), tmp_path / "robot.urdf"]
    named = {"Name": ids(world, "p{}"), **joints(world, "J{} [deg]")}
    files.append(tmp_path / written(tmp_path / "a.csv", named))
    made = lc.init(*files, urdf=tmp_path / "robot.urdf")
    assert len(made.dataset) == len(world.q)


def test_a_machine_of_two_limbs_is_told_to_state_what_is_observed(tmp_path: Path) -> None:
    limb = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}"/>
    <origin xyz="0.3 0 0.1"/><axis xyz="0 1 0"/><limit lower="-3" upper="3"/></joint>
    <link name="{0}"/>"""
    pairs = [("a0", "bed"), ("a1", "a0"), ("b0", "bed"), ("b1", "b0")]
    limbs = [limb.format(*pair) for pair in pairs]
    text = f'<robot name="two"><link name="bed"/>{"".join(limbs)}</robot>'
    (tmp_path / "two.urdf").write_text(text, "utf-8")
    rng = np.random.default_rng(3)
    columns = of(["a0", "a1", "b0", "b1", "x", "y", "z"], rng.uniform(-1.0, 1.0, (20, 7)))
    written(tmp_path / "a.csv", columns)
    with refused("unknown-name", "--tip 'a1'", "several limbs", "--observe"):
        lc.init(tmp_path / "a.csv", urdf=tmp_path / "two.urdf")


def test_slides_and_the_points_that_they_move_are_told_by_the_user(tmp_path: Path) -> None:
    q, points = slides(tmp_path, 3)
    numbers = [str(i) for i in range(len(q))]
    written(tmp_path / "nc.csv", {"N": numbers, **of("XYZ", q)})
    written(tmp_path / "tracker.csv", {"N": numbers, **of("XYZ", points)})
    files = tmp_path / "nc.csv", tmp_path / "tracker.csv"
    with refused("unknown-unit", "--joints") as caught:
        lc.init(*files, dh=tmp_path / "dh.csv")
    assert caught.value.options == ("--joints", "X,Y,Z")
    made = lc.init(*files, dh=tmp_path / "dh.csv", joints="X,Y,Z")
    assert np.allclose(made.dataset["x"], 1e-3 * points[:, 0], atol=1e-8)


MACHINE = """schema = 1
type = "linear-delta"
units = { length = "mm", angle = "deg" }
home = { platform_z = 35 }
[parameters]
a1_x = -121.244
a1_y = -70.0
a2_x = 121.244
a2_y = -70.0
a3_x = 0.0
a3_y = 140.0
"rod_*" = 300
"""


def delta(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Carriages and points [mm] of a linear delta, seen from anywhere."""
    rng = np.random.default_rng(seed)
    a = np.array([[-121.244, -70.0], [121.244, -70.0], [0.0, 140.0]])
    P = rng.uniform([-70, -70, -15], [70, 70, 85], (40, 3))
    across = np.square(P[:, None, :2] - a).sum(axis=2)
    carriages = P[:, 2:] + np.sqrt(300.0**2 - across)
    points = Rotation.from_rotvec([0.01, 0.02, rng.uniform(-3, 3)]).apply(P) + AWAY
    return carriages, points + rng.normal(0.0, 0.015, points.shape)


def test_a_later_day_of_closed_loops_may_have_other_columns(tmp_path: Path) -> None:
    (tmp_path / "delta.toml").write_text(MACHINE, "utf-8")
    q, points = delta(1)
    first = {**of((f"Turm {i} [mm]" for i in "ABC"), q), **xyz("{} [mm]", 1e-3 * points)}
    written(tmp_path / "first.csv", first)
    project = lc.init(tmp_path / "first.csv", machine=str(tmp_path / "delta.toml"))
    q, points = delta(2)
    later = {**of((f"Carriage{i}" for i in (1, 2, 3)), q), **of(["Px", "Py", "Pz"], points)}
    written(tmp_path / "later.csv", later)
    read = new_readings(tmp_path / "later.csv", project.inputs, project.mechanism, whole=True)
    assert np.allclose(read["slide_2"], 1e-3 * q[:, 1], atol=1e-8)
    assert np.allclose(read["y"], 1e-3 * points[:, 1], atol=1e-8)


@pytest.mark.parametrize("first", ["points", "polar"])
def test_a_later_day_may_have_points_in_place_of_range_and_angles(
    tmp_path: Path, first: str
) -> None:
    """And the reverse."""
    world = World("six", 12)
    described(world, tmp_path)
    measured = {
        "points": xyz("{} [mm]", world.points),
        "polar": of(["Range [mm]", "Hz [deg]", "V [deg]"], polar(world.points) * [1, -1, 1]),
    }
    written(tmp_path / "first.csv", {**joints(world), **measured.pop(first)}, digits=9)
    project = lc.init(tmp_path / "first.csv", dh=tmp_path / "dh.csv")
    (later,) = measured.values()
    written(tmp_path / "b.csv", {**joints(world, "axis {} [deg]"), **later}, digits=9)
    read = new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    for name, values in project.dataset.readings.items():
        if "azimuth" in name:
            assert np.allclose(np.exp(1j * (read[name] - values)), 1.0, atol=1e-8)
        else:
            assert np.allclose(read[name], values, atol=1e-8)


def two_stations(folder: Path) -> tuple[World, lc.InitialProject]:
    world = World("six", 13)
    described(world, folder)
    even = np.arange(len(world.points)) % 2 == 0
    seen = np.where(even[:, None], world.points, world.elsewhere)
    where = {"Station": ["S1" if one else "S2" for one in even]}
    written(folder / "first.csv", {**where, **joints(world), **xyz("{} [mm]", seen)}, digits=9)
    return world, lc.init(folder / "first.csv", dh=folder / "dh.csv")


@pytest.mark.parametrize("where", [None, "S1", "S7"])
def test_a_later_day_of_one_station_is_of_any_of_two(tmp_path: Path, where: str | None) -> None:
    """The instrument stands anew: without the column, or with a label of that day."""
    world, project = two_stations(tmp_path)
    later = {} if where is None else {"Station": [where] * len(world.points)}
    written(tmp_path / "b.csv", {**later, **joints(world), **xyz("{} [mm]", world.points)})
    read = new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    assert np.allclose(read["x_1"], world.points[:, 0], atol=1e-6)
    assert np.isnan(read["x_2"]).all()


def test_labels_of_which_some_are_of_the_first_day_are_not_taken_for_others(
    tmp_path: Path,
) -> None:
    world, project = two_stations(tmp_path)
    labels = ["S2", "S3"] * (len(world.points) // 2)
    written(tmp_path / "b.csv", {"Station": labels, **joints(world), **xyz("{}", world.points)})
    with refused("unknown-name", "row 2 of the readings is of station 'S3'"):
        new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)


def test_legs_that_no_platform_has_are_refused(tmp_path: Path) -> None:
    """Where the loops close nowhere no trial of signs has a body to compare with."""
    rng = np.random.default_rng(3)
    legs = {f"L{i} [mm]": rng.uniform(630, 760, 40) for i in range(1, 7)}
    written(tmp_path / "a.csv", {**legs, **xyz("{} [mm]", rng.uniform(1.0, 2.0, (40, 3)))})
    (tmp_path / "m.toml").write_text('schema = 1\ntype = "stewart-gough"\n', "utf-8")
    with refused("implausible-readings", "does not describe", "those left out have the values"):
        lc.init(tmp_path / "a.csv", machine=str(tmp_path / "m.toml"))


def test_later_columns_called_as_the_joints_are_no_radians(tmp_path: Path) -> None:
    """The first day was converted to rad, in columns of the same names: degrees were taken so."""
    world = World("six", 8)
    described(world, tmp_path)
    first = [tmp_path / name for name in jointtargets_in_tens(world, tmp_path)]
    lc.init(*first, dh=tmp_path / "dh.csv", out=tmp_path / "cal")
    project = lc.read_project(tmp_path / "cal" / "project.toml")
    degrees = of(project.mechanism.joints, np.degrees(world.read))
    later = tmp_path / written(tmp_path / "later.csv", degrees, digits=9)
    with refused("missing-column", "later.csv"):
        new_readings(later, project.inputs, project.mechanism)
    stated = {f"{name} [deg]": values for name, values in degrees.items()}
    later = tmp_path / written(tmp_path / "stated.csv", stated, digits=9)
    read = new_readings(later, project.inputs, project.mechanism)
    for i, name in enumerate(project.mechanism.joints):
        assert np.allclose(read[name], world.read[:, i], atol=1e-6)
    columns = {**degrees, **of("xyz", 1e3 * world.points)}
    both = tmp_path / written(tmp_path / "both.csv", columns, digits=9)
    read = new_readings(both, project.inputs, project.mechanism, whole=True)
    for i, name in enumerate(project.mechanism.joints):
        assert np.allclose(read[name], world.read[:, i], atol=1e-6)
    assert np.allclose(read["x"], world.points[:, 0], atol=1e-6)


def test_predict_refuses_radians_without_a_unit_beside_degrees(tmp_path: Path) -> None:
    """They were taken for degrees: the arm hardly moved, and its sds were as small as ever."""
    world = World("six", 8)
    described(world, tmp_path)
    columns = {"pose": ids(world, "p{}"), **joints(world), **xyz("{} [mm]", world.points)}
    lc.init(
        tmp_path / written(tmp_path / "a.csv", columns),
        dh=tmp_path / "dh.csv",
        out=tmp_path / "cal",
    )
    project = tmp_path / "cal" / "project.toml"
    run_calibration(project, Request(method="implicit-loop"), out=tmp_path / "result")
    names = [name for name in columns if name not in ("pose", "x [mm]", "y [mm]", "z [mm]")]
    for unit, to in (("rad", 1.0), ("deg", np.degrees(1.0))):
        later = tmp_path / f"{unit}.csv"
        written(later, of(names, to * world.read), digits=9)
        if unit == "deg":
            assert len(run_prediction(tmp_path / "result", later, out=None).poses) == len(world.q)
            continue
        with refused("implausible-unit", "rad.csv", "J1 [rad]"):
            run_prediction(tmp_path / "result", later, out=None)


def test_predict_refuses_degrees_without_a_unit_beside_radians(tmp_path: Path) -> None:
    """Also in some rows: points were metres off, with an sd of 100 mm."""
    world = World("six", 8)
    described(world, tmp_path)
    names = [f"J{i}" for i in range(1, 7)]
    first = {**of(names, world.read), **xyz("{} [mm]", world.points)}
    file = tmp_path / written(tmp_path / "a.csv", first, digits=9)
    lc.init(file, dh=tmp_path / "dh.csv", out=tmp_path / "cal")
    project = tmp_path / "cal" / "project.toml"
    run_calibration(project, Request(method="implicit-loop"), out=tmp_path / "result")
    half = np.arange(len(world.q)) >= len(world.q) // 2
    for degrees, words in ((half, "poses"), (half | True, "all.csv"), (half & False, "")):
        read = np.where(degrees[:, None], np.degrees(world.read), world.read)
        later = tmp_path / written(tmp_path / "all.csv", of(names, read), digits=9)
        if not words:
            assert len(run_prediction(tmp_path / "result", later, out=None).poses) == len(world.q)
            continue
        with refused("implausible-unit", words, "J1 [deg]"):
            run_prediction(tmp_path / "result", later, out=None)


@pytest.mark.parametrize("kind", ["csv", "xlsx"])
def test_a_later_file_may_be_of_another_kind(tmp_path: Path, kind: str) -> None:
    """The sheet of the first day's workbook was asked of a text, its delimiter of a workbook."""
    world = World("six", 8)
    described(world, tmp_path)
    columns = {**joints(world), **xyz("{} [mm]", world.points)}
    files = {"csv": tmp_path / written(tmp_path / "a.csv", columns, digits=9)}
    files["xlsx"] = tmp_path / "a.xlsx"
    pl.DataFrame(columns).write_excel(files["xlsx"], worksheet="Day 1")
    first = files["xlsx" if kind == "csv" else "csv"]
    sheet = "Day 1" if kind == "csv" else None
    lc.init(first, sheet=sheet, dh=tmp_path / "dh.csv", out=tmp_path / "cal")
    project = tmp_path / "cal" / "project.toml"
    text = project.read_text("utf-8")
    if kind == "xlsx":
        project.write_text(text.replace("[data]\n", '[data]\ndelimiter = ","\n'), "utf-8")
    else:
        assert 'sheet = "Day 1"' in text
    made = lc.read_project(project)
    for whole in (True, False):
        read = read_new_readings(files[kind], made.inputs, made.mechanism, whole=whole)
        for i, name in enumerate(made.mechanism.joints):
            np.testing.assert_allclose(read[name], world.read[:, i], atol=1e-6)


def test_later_rows_of_stations_are_read_as_those_of_the_first_day(tmp_path: Path) -> None:
    """Their joints' columns state a unit, as those of the converted readings do."""
    world = World("six", 8)
    described(world, tmp_path)
    stations = ["north" if i % 2 else "south" for i in range(len(world.q))]
    points = world.points + np.where(np.arange(len(world.q)) % 2, 1.0, 0.0)[:, None]
    columns = {**joints(world, "joint_a{} [deg]"), "station": stations, **xyz("{} [mm]", points)}
    file = tmp_path / written(tmp_path / "a.csv", columns, digits=9)
    lc.init(file, urdf=tmp_path / "robot.urdf", out=tmp_path / "cal")
    project = lc.read_project(tmp_path / "cal" / "project.toml")
    first = lc.load_dataset(project).dataset
    for whole in (True, False):
        read = read_new_readings(file, project.inputs, project.mechanism, whole=whole)
        for name in read.readings:
            np.testing.assert_allclose(read[name], first[name], atol=1e-7)
        assert whole == ("x_1" in read.readings)
