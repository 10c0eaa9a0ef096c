"""Headers, columns and tables of robots as people write them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.estimation.mounted import bodies_of
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.dh_table import chain_rows, read_dh
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.headers import heading
from loopcal.files.recognition.joint_sets import usual_joints
from loopcal.files.recognition.layouts import instruments, layouts
from loopcal.files.recognition.robots import dh_robot
from loopcal.mechanisms.frame import ChainFrame
from tests.refusals import refused


@pytest.mark.parametrize(
    ("text", "stem", "unit"),
    [
        ("J1 [deg]", "j1", "deg"),
        ("X (mm)", "x", "mm"),
        ("theta1_rad", "theta1", "rad"),
        ("q1/deg", "q1", "deg"),
        ("θ1 (°)", "theta1", "deg"),
        ("Joint 3 [degrees]", "joint_3", "deg"),
        ("TX {inch}", "tx", "in"),
        ("axis_2_gon", "axis_2", "gon"),
        ("x_m", "x", "m"),
        ("L", "l", None),
        ("u_x [µm]", "u_x", "um"),
        ("point x", "point_x", None),
        ("time_s", "time", "s"),
        ("timestamp_us", "timestamp", "us"),
        ("joint_s", "joint_s", None),
    ],
)
def test_a_header_is_a_name_and_a_unit(text: str, stem: str, unit: str | None) -> None:
    found = heading(text)
    assert (found.stem, found.unit) == (stem, unit)


def fields(names: str, values: np.ndarray | None = None) -> list[Field]:
    words = names.split()
    table = np.random.default_rng(0).normal(size=(20, len(words))) if values is None else values
    return [Field(0, i, heading(n), table[:, i]) for i, n in enumerate(words)]


@pytest.mark.parametrize(
    "names",
    [
        "J1 J2 J3 J4 J5 J6",
        "q1 q2 q3 q4 q5 q6",
        "theta_1 theta_2 theta_3",
        "axis1 axis2 axis3 axis4",
        "A1 A2 A3 A4 A5 A6",
        "S L U R B T",
        "S L E U R B T",
        "base shoulder elbow wrist1 wrist2 wrist3",
        "panda_joint1 panda_joint2 panda_joint3",
        "joint_1_pos joint_2_pos joint_3_pos",
    ],
)
def test_joints_are_known_by_their_usual_names(names: str) -> None:
    columns = fields(f"time x y z {names}")
    found = usual_joints(columns)
    assert sorted(f.position for f in found) == list(range(4, 4 + len(names.split())))


@pytest.mark.parametrize(
    ("names", "still", "position"),
    [
        ("one two three four", 5, (2, 3, 4)),  # an sd behind the point
        ("tracker[0] tracker[1] tracker[2] temp[0] temp[1] temp[2]", None, (2, 3, 4)),
        ("one two three four", 4, None),  # the third coordinate may be the one that stands still
    ],
)
def test_a_point_without_x_y_and_z_is_known_by_order_or_number(
    names: str, still: int | None, position: tuple[int, ...] | None
) -> None:
    columns = fields(f"J1 J2 {names}")
    if still is not None:
        columns[still].values[:] = 0.01
    if position is None:
        with refused("missing-column", "no column of an instrument is recognised"):
            layouts(columns, 2)
        return
    (layout,) = layouts(columns, 2)
    assert [f.position for f in layout.joints] == [0, 1]
    assert tuple(f.position for s in layout.seen for f in s.position) == position


def test_an_external_axis_that_stands_still_is_no_joint() -> None:
    values = np.random.default_rng(0).normal(size=(20, 7))
    values[:, 2] *= 1e-5
    names = [f.stem for f in usual_joints(fields("S L E U R B T", values))]
    assert names == ["s", "l", "u", "r", "b", "t"]


@pytest.mark.parametrize(
    ("names", "kinds"),
    [
        ("x y z", ["point"]),
        ("x1 y1 z1 x2 y2 z2", ["point", "point"]),
        ("TX TY TZ u_TX u_TY u_TZ", ["point"]),
        ("meas_x meas_y meas_z cmd_x cmd_y cmd_z vx vy vz", ["point"]),
        ("L", ["length"]),
        ("wire_1 wire_2", ["length", "length"]),
        ("range azimuth elevation", ["spherical"]),
        ("x y z rx ry rz", ["pose"]),
        ("X Y Z A B C", ["pose"]),
    ],
)
def test_instruments_are_known_by_their_columns(names: str, kinds: list[str]) -> None:
    assert [s.kind for s in instruments(fields(names))] == kinds


def test_points_in_another_file_than_range_and_angles_are_another_instrument() -> None:
    polar, computed = ["range", "azimuth", "elevation"], ["x", "y", "z"]
    columns = fields(" ".join([*polar, *computed]))
    assert [s.kind for s in instruments(columns)] == ["spherical"]
    apart = [replace(f, table=int(f.stem in computed)) for f in columns]
    assert [s.kind for s in instruments(apart)] == ["spherical", "point"]
    far = np.sqrt(sum(np.square(f.values) for f in apart[3:]))
    same = [replace(apart[0], values=1e3 * far), *apart[1:]]
    assert [s.kind for s in instruments(same)] == ["spherical"]


def test_sds_go_with_their_coordinates() -> None:
    (seen,) = instruments(fields("x y z sd_x sd_y sd_z"))
    assert [f.stem for f in seen.sds] == ["sd_x", "sd_y", "sd_z"]


def written(folder: Path, text: str) -> Path:
    path = folder / "dh.csv"
    path.write_text(text, "utf-8")
    return path


def test_units_of_a_dh_table_follow_from_its_size(tmp_path: Path) -> None:
    table = read_dh(written(tmp_path, "a,d,alpha,theta\n0,290,90,0\n270,0,0,-90\n"))
    assert table.rows[0].d == pytest.approx(0.29)
    assert table.rows[1].offset == pytest.approx(-np.pi / 2)
    assert any("mm" in words for words in table.remarks)
    table = read_dh(written(tmp_path, "a,d,alpha\n0,0.29,1.5708\n0.27,0,0\n"))
    assert table.rows[0].d == pytest.approx(0.29)
    assert table.rows[0].alpha == pytest.approx(1.5708)


def test_a_size_that_shows_no_unit_is_refused(tmp_path: Path) -> None:
    with refused("unknown-unit"):
        read_dh(written(tmp_path, "a,d,alpha\n0,20,90\n20,0,0\n"))


def test_the_modified_convention_is_the_classical_one_displaced(tmp_path: Path) -> None:
    text = "a_i-1,d,alpha_i-1,theta\n0,0.4,0,0\n0.1,0,1.5,0.2\n0.6,0.1,0.7,0.3\n"
    table = read_dh(written(tmp_path, text))
    assert table.modified
    before, rows = chain_rows(table)
    assert before == {"rx": 0.0, "tx": 0.0}
    assert [(r.a, r.alpha, r.d) for r in rows] == [
        (0.1, 1.5, 0.4),
        (0.6, 0.7, 0.0),
        (0.0, 0.0, 0.1),
    ]


def test_rows_of_tools_do_not_move_and_signs_are_read(tmp_path: Path) -> None:
    text = "joint,a,d,alpha,theta,direction\nJ1,0,400,90,0,-1\nJ2,300,0,0,0,1\ntool,45,245,0,-20,\n"
    table = read_dh(written(tmp_path, text))
    assert table.moving == 2
    assert [r.direction for r in table.rows[:2]] == [-1, 1]
    assert table.rows[2].kind == "fixed"


def test_cells_of_a_dh_table_may_hold_variables_and_pi(tmp_path: Path) -> None:
    text = "a,d,alpha,theta\n0,0.4,-pi/2,q1\n0.3,0,0,q2 - pi/2\n0,d3+0.1,π,0\n"
    table = read_dh(written(tmp_path, text))
    assert [r.alpha for r in table.rows] == pytest.approx([-np.pi / 2, 0.0, np.pi])
    assert [r.offset for r in table.rows] == pytest.approx([0.0, -np.pi / 2, 0.0])
    assert [r.kind for r in table.rows] == ["revolute", "revolute", "prismatic"]
    assert table.rows[2].d == pytest.approx(0.1)
    text = "a,d,alpha,theta\n0,400,-90°,θ1\n300,0,0,θ2 − 90°\n"
    table = read_dh(written(tmp_path, text))
    assert table.rows[1].offset == pytest.approx(-np.pi / 2)
    with refused("invalid-number"):
        read_dh(written(tmp_path, "a,d,alpha,theta\n0,400,90,see drawing\n"))


# The same four joints as programs and pages write them.
WRITINGS = {
    "a row per quantity": "link,1,2,3,4\ntheta0 [deg],0,-90,0,0\nd [mm],400,0,0,500\n"
    "a [mm],100,300,0,0\nalpha [deg],-90,0,90,0\n",
    "Markdown": "| Joint | θ (deg) | d (mm) | a (mm) | α (deg) |\n|---|---|---|---|---|\n"
    "| 1 | θ1 | 400 | 100 | -90 |\n| 2 | θ2 - 90 | 0 | 300 | 0 |\n| 3 | θ3 | 0 | 0 | 90 |\n"
    "| 4 | θ4 | 500 | 0 | 0 |\n",
    "MATLAB, names in quotes": "".join(
        f"L({i}) = Link('d', {d}, 'a', {a}, 'alpha', {alpha}, 'offset', {offset});\n"
        for i, d, a, alpha, offset in (
            (1, 0.4, 0.1, -1.570796, 0),
            (2, 0, 0.3, 0, -1.570796),
            (3, 0, 0, 1.570796, 0),
            (4, 0.5, 0, 0, 0),
        )
    ),
    "lists of YAML": "dh_a: [0.1, 0.3, 0, 0]\ndh_d: [0.4, 0, 0, 0.5]\n"
    "dh_alpha: [-1.570796, 0, 1.570796, 0]\ndh_theta: [0, -1.570796, 0, 0]\n",
}


@pytest.mark.parametrize("text", WRITINGS.values(), ids=WRITINGS)
def test_a_dh_table_is_read_however_it_is_written(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.txt"
    path.write_text(text, "utf-8")
    rows = read_dh(path).rows
    assert [r.a for r in rows] == pytest.approx([0.1, 0.3, 0.0, 0.0])
    assert [r.d for r in rows] == pytest.approx([0.4, 0.0, 0.0, 0.5])
    assert [r.alpha for r in rows] == pytest.approx([-np.pi / 2, 0.0, np.pi / 2, 0.0], abs=1e-6)
    assert [r.offset for r in rows] == pytest.approx([0.0, -np.pi / 2, 0.0, 0.0], abs=1e-6)


def test_a_table_without_alpha_is_refused(tmp_path: Path) -> None:
    with refused("missing-column", "alpha"):
        read_dh(written(tmp_path, "a,d,theta\n0,400,0\n"))


def test_each_angle_of_a_table_has_the_unit_that_it_shows(tmp_path: Path) -> None:
    path = tmp_path / "dh.csv"
    path.write_text("a,d,alpha [deg]\n0,0.4,-pi/2\n0.3,0,0\n0,0.1,90\n", "utf-8")
    assert [row.alpha for row in read_dh(path).rows] == pytest.approx(
        [-math.pi / 2, 0.0, math.pi / 2]
    )
    path.write_text("a,d,alpha\n0,0.4,-pi/2\n0.3,0,90°\n0,1/2,0\n", "utf-8")
    rows = read_dh(path).rows
    assert [row.alpha for row in rows] == pytest.approx([-math.pi / 2, math.pi / 2, 0.0])
    assert rows[2].d == pytest.approx(0.5)
    path.write_text("a,d,alpha\n0,0.4,pi/0\n0.3,0,0\n", "utf-8")
    with refused("invalid-number", "pi/0"):
        read_dh(path)


def test_fixed_rows_may_follow_each_other(tmp_path: Path) -> None:
    """Before the first joint, between joints and behind the last: the machine is that product."""
    text = """name,a [m],d [m],alpha [deg],theta [deg],kind
base,0.1,0.2,30,10,fixed
stand,0.05,0.4,-20,40,fixed
q1,0.3,0.1,90,0,
link,0.02,0,15,5,fixed
plate,0,0.07,0,25,fixed
q2,0.4,0,0,0,
tool,0.1,0.05,0,0,fixed
tip,0.02,0.03,90,90,fixed
"""
    for form, modified in (("dh", False), ("modified", True)):
        path = written(tmp_path, text)
        if modified:
            path.write_text(text.replace("a [m]", "a_i-1 [m]"), "utf-8")
        rows = [line.split(",") for line in text.splitlines()[1:]]
        joints = {"q1": 0.7, "q2": -1.1}
        T = np.eye(4)
        for name, a, d, alpha, theta, _ in rows:
            turn = motion("rz", np.radians(float(theta)) + joints.get(name, 0.0))
            own = turn @ motion("tz", float(d))
            across = motion("tx", float(a)) @ motion("rx", np.radians(float(alpha)))
            # classical: Rz Tz Tx Rx; modified: Rx Tx Rz Tz, where Rx and Tx commute
            T = T @ (across @ own if modified else own @ across)
        made = dh_robot(path, ())
        mechanism = mechanism_from_data(dict(made.table), "project.toml")
        values = {p.name: p.nominal for p in mechanism.parameters}
        its = {n: np.array([q]) for n, q in joints.items()}
        bodies = bodies_of(ChainFrame(mechanism.chain, its, values), 1)
        assert np.allclose(bodies.origins[0], T[:3, 3], atol=1e-9), form
        assert np.allclose(bodies.rotations[0], T[:3, :3], atol=1e-9), form


def test_a_slide_parallel_to_the_next_axis_may_tilt_both_ways(tmp_path: Path) -> None:
    """Without beta, a tilt about y would turn the slide about its axis by up to a right angle."""
    text = """name,a,d,alpha,theta,kind
q1,350,200,0,0,
q2,300,0,180,0,
q3,0,50,0,0,prismatic
q4,0,80,0,0,
"""
    made = dh_robot(written(tmp_path, text), ())
    mechanism = mechanism_from_data(dict(made.table), "project.toml")
    names = mechanism.parameters.names
    assert {"alpha_3", "beta_3", "alpha_2", "beta_2"} <= set(names)
    values = {p.name: p.nominal for p in mechanism.parameters}
    q = {"q1": 0.3, "q2": -0.8, "q3": 0.04, "q4": 1.1}
    readings = {n: np.array([v]) for n, v in q.items()}
    here = bodies_of(ChainFrame(mechanism.chain, readings, values), 1)
    assert here.origins[0][2] == pytest.approx(0.2 - 0.05 - 0.04 - 0.08)
    turned = bodies_of(ChainFrame(mechanism.chain, readings, values | {"beta_3": 1e-3}), 1)
    assert turned.rotations[0][2] @ here.rotations[0][2] < 1.0 - 4e-7


def motion(kind: str, value: float) -> np.ndarray:
    T = np.eye(4)
    axis = "xyz".index(kind[1])
    if kind[0] == "t":
        T[axis, 3] = value
    else:
        T[:3, :3] = Rotation.from_rotvec(value * np.eye(3)[axis]).as_matrix()
    return T
