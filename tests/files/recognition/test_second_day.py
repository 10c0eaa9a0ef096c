"""A file of another day, written as the first one was, is read by what `init` stated of that."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.files.project.project_data import read_new_readings
from loopcal.files.project.project_file import read_project
from loopcal.workflow.beginning.initial import initial_project
from loopcal.workflow.beginning.robot_file import RobotFile
from loopcal.workflow.readings import new_readings
from tests.reference import dh_arm
from tests.refusals import refused

Array = np.ndarray
NAMES = [f"J{i}" for i in range(1, 7)]
NORTH = np.array([1.0, 0.3, 0.2])
"""Where a second station sees the origin of the first [m]."""
Text = Callable[[Array, Array], dict[str, str]]
"""Joints (N, 6) [rad] and T_station_target (N, 4, 4) [m] as files: name -> text."""


def written(columns: Mapping[str, Any], separator: str = ",") -> str:
    rows = [separator.join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = [c if isinstance(c, str) else f"{c:.9f}" for c in row]
        rows.append(separator.join(c.replace(".", ",") if separator == ";" else c for c in cells))
    return "\n".join(rows) + "\n"


def joints_of(q: Array, names: list[str] = NAMES, factor: float = 180 / np.pi) -> dict[str, Array]:
    return dict(zip(names, factor * q.T, strict=True))


def points_of(p: Array, names: str | list[str] = "xyz", factor: float = 1e3) -> dict[str, Array]:
    return dict(zip(names, factor * p.T, strict=True))


def ids(q: Array) -> list[str]:
    return [f"p{i}" for i in range(len(q))]


def stations(q: Array, T: Array) -> dict[str, str]:
    at = ["north" if i % 2 else "south" for i in range(len(q))]
    p = np.where(np.array(at)[:, None] == "north", T[:, :3, 3] + NORTH, T[:, :3, 3])
    return {"a.csv": written({"station": at, **joints_of(q), **points_of(p)})}


def stations_and_poses(q: Array, T: Array) -> dict[str, str]:
    p = T[:, :3, 3]
    both = np.concatenate([p, p + NORTH])
    at = ["south"] * len(q) + ["north"] * len(q)
    columns = {"pose": 2 * ids(q), "station": at, **joints_of(np.concatenate([q, q]))}
    return {"a.csv": written({**columns, **points_of(both)})}


def two_files(q: Array, T: Array) -> dict[str, str]:
    joints = written({"pose": ids(q), **joints_of(q)})
    backwards = slice(None, None, -1)
    points = {"pose": ids(q)[backwards], **points_of(T[backwards, :3, 3])}
    return {"joints.csv": joints, "points.csv": written(points)}


def plain(q: Array, T: Array) -> dict[str, str]:
    return {"a.csv": written(joints_of(q) | points_of(T[:, :3, 3]))}


def titled(q: Array, T: Array) -> dict[str, str]:
    return {"a.csv": "// day 2\n" + renamed(q, T)["a.csv"].partition("\n")[2]}


def renamed(q: Array, T: Array) -> dict[str, str]:
    names = [f"Achse {i} [deg]" for i in range(1, 7)]
    columns = joints_of(q, names) | points_of(T[:, :3, 3], ["X (mm)", "Y (mm)", "Z (mm)"])
    return {"a.csv": "Messung 7\n" + written(columns)}


def comma(q: Array, T: Array) -> dict[str, str]:
    return {"a.csv": "Halle 3; Tracker\n" + written(joints_of(q) | points_of(T[:, :3, 3]), ";")}


def shots(q: Array, T: Array) -> dict[str, str]:
    off = np.array([-0.01, 0.0, 0.01]) * 1e-3
    p = (T[:, None, :3, 3] + off[:, None]).reshape(-1, 3)
    columns = joints_of(np.repeat(q, 3, axis=0), [f"theta_{i}" for i in range(1, 7)])
    return {"a.csv": written({"pose": np.repeat(ids(q), 3).tolist(), **columns, **points_of(p)})}


def total_station(q: Array, T: Array) -> dict[str, str]:
    x, y, z = T[:, :3, 3].T
    r = np.sqrt(x**2 + y**2 + z**2)
    columns = {"range": r, "azimuth": -np.arctan2(y, x), "zenith": np.arccos(z / r)}
    gon = {name: v * (1.0 if name == "range" else 200 / np.pi) for name, v in columns.items()}
    gon["elevation"] = gon.pop("zenith")
    return {"a.csv": written({**joints_of(q), **gon})}


def turned(q: Array, T: Array) -> dict[str, str]:
    turns = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX", degrees=True)
    return {"a.csv": written(joints_of(q) | points_of(T[:, :3, 3]) | points_of(turns, "abc", 1.0))}


def inverted(q: Array, T: Array) -> dict[str, str]:
    back = np.linalg.inv(T)
    turns = Rotation.from_matrix(back[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    columns = joints_of(q) | points_of(back[:, :3, 3])
    return {"a.csv": written(columns | points_of(turns, ["qw", "qx", "qy", "qz"], 1.0))}


LAYOUTS: dict[str, Text] = {
    f.__name__: f
    for f in (
        stations, stations_and_poses, two_files, comma, shots, total_station, turned, inverted,
    )
}  # fmt: skip


def kept(folder: Path, files: Mapping[str, str]) -> list[Path]:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text, "utf-8")
    return [folder / name for name in files]


def begun(tmp_path: Path, paths: list[Path], joints: str | None = None) -> Any:
    (tmp_path / "dh.csv").write_text(dh_arm.dh_table(), "utf-8")
    robot = RobotFile(dh=tmp_path / "dh.csv", joints=joints)
    initial_project(paths, robot, out=tmp_path / "calibration")
    return read_project(tmp_path / "calibration" / "project.toml")


def day(rows: slice) -> tuple[Array, Array]:
    q = dh_arm.poses()
    return q[rows], dh_arm.seen(q, sd=5e-5, turned=2e-4)[rows]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_file_of_another_day_is_read_as_the_first_was(layout: str, tmp_path: Path) -> None:
    first, second = day(slice(0, 40)), day(slice(60, 80))
    files = kept(tmp_path / "first", LAYOUTS[layout](*first))
    project = begun(tmp_path, files)
    _agrees_with_converted(files, project)
    paths = kept(tmp_path / "second", LAYOUTS[layout](*second))
    read = read_new_readings(paths, project.inputs, project.mechanism, whole=True)
    q, T = second
    assert read.readings.keys() == _read(project)
    for i, name in enumerate(list(read.readings)[:6]):
        np.testing.assert_allclose(read[name], q[:, i], atol=1e-9)
    if layout == "total_station":
        polar = np.array([read[n] for n in ("tracker_range", "tracker_azimuth")])
        expected = [np.linalg.norm(T[:, :3, 3], axis=1), np.arctan2(T[:, 1, 3], T[:, 0, 3])]
        np.testing.assert_allclose(polar, expected, atol=1e-8)
        return
    two = layout.startswith("stations")
    names = [f"{a}_{k}" for k in (1, 2) for a in "xyz"] if two else [*"xyz"]
    points = np.array([read[n] for n in names]).T
    south = T[:, :3, 3]
    if layout == "stations":  # the first label that occurs is that of the first instrument
        odd = np.arange(len(q)) % 2 == 1
        assert np.isnan(points[odd, :3]).all()
        assert np.isnan(points[~odd, 3:]).all()
        np.testing.assert_allclose(points[odd, 3:], south[odd] + NORTH, atol=1e-9)
        np.testing.assert_allclose(points[~odd, :3], south[~odd], atol=1e-9)
    else:
        np.testing.assert_allclose(points[:, :3], south, atol=1e-9)
    if "qw" in read.readings:
        turns = np.array([read[n] for n in ("qx", "qy", "qz", "qw")]).T
        R = Rotation.from_quat(turns).as_matrix()
        np.testing.assert_allclose(R, T[:, :3, :3], atol=1e-6)


def _read(project: Any) -> set[str]:
    parts = (project.inputs["data"], *project.inputs["data"].get("join", ()))
    return {quantity for part in parts for quantity in part["columns"]}


def _agrees_with_converted(files: list[Path], project: Any) -> None:
    """The first files are what the file beside the project holds."""
    converted = project.folder / "readings.csv"
    if not converted.exists():  # two files are read where they are
        return
    read, source = (
        read_new_readings(path, project.inputs, project.mechanism, whole=True)
        for path in (converted, files)
    )
    for name, values in source.readings.items():
        np.testing.assert_allclose(read[name], values, atol=1e-12)


def test_stations_are_told_by_their_labels(tmp_path: Path) -> None:
    project = begun(tmp_path, kept(tmp_path / "first", stations(*day(slice(0, 40)))))
    _, T = day(slice(61, 81))  # the other station comes first
    text = stations(*day(slice(60, 81)))["a.csv"].splitlines(keepends=True)
    (tmp_path / "b.csv").write_text("".join([text[0], *text[2:]]), "utf-8")
    read = read_new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    assert np.isnan(read["x_1"][0])
    assert not np.isnan(read["x_2"][0])
    np.testing.assert_allclose(read["x_1"][1], T[1, 0, 3], atol=1e-9)
    (tmp_path / "c.csv").write_text("".join(text).replace("north", "west"), "utf-8")
    with refused("unknown-name", "west", "north"):
        read_new_readings(tmp_path / "c.csv", project.inputs, project.mechanism, whole=True)


def test_a_day_from_one_station_alone_has_no_readings_of_the_other(tmp_path: Path) -> None:
    for number, layout in enumerate((stations, stations_and_poses)):
        folder = tmp_path / str(number)
        folder.mkdir()
        project = begun(folder, kept(folder / "first", layout(*day(slice(0, 40)))))
        text = layout(*day(slice(60, 80)))["a.csv"].splitlines(keepends=True)
        (folder / "b.csv").write_text("".join(t for t in text if "south" not in t), "utf-8")
        read = read_new_readings(folder / "b.csv", project.inputs, project.mechanism, whole=True)
        south = read.readings.get("x_1", np.array([np.nan]))
        assert np.isnan(south).all()
        assert not np.isnan(read["x_2"]).any()


def test_a_header_that_states_another_unit_is_believed(tmp_path: Path) -> None:
    first, (q, T) = day(slice(0, 40)), day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", renamed(*first)))
    names = [f"Achse {i} [rad]" for i in range(1, 7)]
    columns = joints_of(q, names, 1.0) | points_of(T[:, :3, 3], ["X (m)", "Y (m)", "Z (m)"], 1.0)
    (tmp_path / "b.csv").write_text(written(columns), "utf-8")
    read = read_new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose(read["J1"], q[:, 0], atol=1e-8)
    np.testing.assert_allclose(read["x"], T[:, 0, 3], atol=1e-8)


@pytest.mark.parametrize("later", [comma, two_files, renamed, titled, shots])
@pytest.mark.parametrize("first", [comma, two_files, plain])
def test_a_later_day_may_have_other_columns(first: Text, later: Text, tmp_path: Path) -> None:
    q, T = day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", first(*day(slice(0, 40)))))
    texts = {name: re.sub(r"\bJ(?=\d)", "axis_", text) for name, text in later(q, T).items()}
    paths = kept(tmp_path / "second", texts)
    read = new_readings(paths, project.inputs, project.mechanism, whole=True)
    assert [*read.readings] == [*NAMES, *"xyz"]
    np.testing.assert_allclose([read[n] for n in NAMES], q.T, atol=1e-9)
    np.testing.assert_allclose([read[n] for n in "xyz"], T[:, :3, 3].T, atol=1e-9)
    assert read.source.read_as.startswith("Other columns than on the first day")


def quaternions(q: Array, T: Array) -> dict[str, str]:
    """Scalar last, without names that say so."""
    turns = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    numbers = points_of(turns, [f"Q{i}" for i in range(1, 5)], 1.0)
    return {"a.csv": written(joints_of(q) | points_of(T[:, :3, 3]) | numbers)}


def vectors(q: Array, T: Array) -> dict[str, str]:
    turns = points_of(Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), ["rx", "ry", "rz"], 1.0)
    return {"a.csv": written(joints_of(q) | points_of(T[:, :3, 3], factor=1.0) | turns)}


@pytest.mark.parametrize("later", [turned, inverted, quaternions, vectors])
@pytest.mark.parametrize("first", [turned, vectors])
def test_orientations_of_a_later_day_may_be_written_otherwise(
    first: Text, later: Text, tmp_path: Path
) -> None:
    q, T = day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", first(*day(slice(0, 40)))))
    texts = {name: re.sub(r"\bJ(?=\d)", "axis_", text) for name, text in later(q, T).items()}
    paths = kept(tmp_path / "second", texts)
    read = new_readings(paths, project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose([read[n] for n in "xyz"], T[:, :3, 3].T, atol=1e-8)
    (orientation,) = project.mechanism.orientations
    columns = orientation.axes({n: read[n] for n in orientation.columns})
    R = np.stack([np.array([*axis]) for axis in columns], axis=-1)
    np.testing.assert_allclose(R.transpose(1, 0, 2), T[:, :3, :3], atol=1e-7)


def test_a_payload_and_a_temperature_of_a_later_day_may_have_other_names(tmp_path: Path) -> None:
    """And be the same in all rows, where they say nothing on a first day."""
    (q, T), (later, at) = day(slice(0, 40)), day(slice(60, 80))
    rows = np.arange(len(q))
    measured = {"payload [kg]": rows % 3, "temperature [degC]": 20 + rows / 10}
    text = written({**joints_of(q), **points_of(T[:, :3, 3]), **measured})
    project = begun(tmp_path, kept(tmp_path / "first", {"a.csv": text}))
    names = [f"axis_{i}" for i in range(1, 7)]
    constant = {"Load": np.full(len(later), 5.0), "Temp": np.full(len(later), 23.0)}
    columns = {**joints_of(later, names), **points_of(at[:, :3, 3]), **constant}
    paths = kept(tmp_path / "second", {"b.csv": written(columns)})
    read = new_readings(paths, project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose(read["payload"], 5.0)
    np.testing.assert_allclose(read["temperature"], 296.15)
    assert "the payload Load in kg; the temperature Temp in degC" in read.source.read_as


def test_other_columns_that_the_machine_does_not_fit_are_none(tmp_path: Path) -> None:
    first, (q, T) = day(slice(0, 40)), day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", comma(*first)))
    names = [f"axis_{i}" for i in range(1, 7)]
    columns = joints_of(q[:, ::-1], names) | points_of(T[:, :3, 3])
    (tmp_path / "b.csv").write_text(written(columns), "utf-8")
    with refused("missing-column", "J1"):
        new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    columns = joints_of(q, names) | points_of(np.roll(T[:, :3, 3], 1, axis=0))
    (tmp_path / "c.csv").write_text(written(columns), "utf-8")
    with refused("mismatched-poses"):
        new_readings(tmp_path / "c.csv", project.inputs, project.mechanism, whole=True)


def test_an_instrument_that_is_not_used_on_a_day_reads_nothing(tmp_path: Path) -> None:
    def files(rows: slice) -> dict[str, str]:
        q, T = day(rows)
        x, y, z = T[:, :3, 3].T
        polar = [np.hypot(np.hypot(x, y), z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))]
        read = dict(zip(("range [m]", "azimuth [rad]", "elevation [rad]"), polar, strict=True))
        each = {"joints": joints_of(q), "points": points_of(T[:, :3, 3] + NORTH), "polar": read}
        return {f"{name}.csv": written({"pose": ids(q), **of}) for name, of in each.items()}

    project = begun(tmp_path, kept(tmp_path / "first", files(slice(0, 40))))
    joints, points, polar = kept(tmp_path / "second", files(slice(60, 80)))
    for seen, blank in ((points, "tracker_1_range"), (polar, "x_2")):
        read = read_new_readings([joints, seen], project.inputs, project.mechanism, whole=True)
        assert {n for n, v in read.readings.items() if np.isnan(v).any()} >= {blank}
        assert sum(np.isnan(v).all() for v in read.readings.values()) == 3
    text = polar.read_text("utf-8").replace("range", "distance")
    (other,) = kept(tmp_path / "third", {"polar.csv": text})
    with refused("missing-column", "range"):  # it may be the same by another name
        read_new_readings([joints, points, other], project.inputs, project.mechanism, whole=True)


def test_points_alone_do_not_serve_where_poses_were_measured(tmp_path: Path) -> None:
    q, T = day(slice(0, 40))
    turned = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    columns = {
        **joints_of(q, [f"J{i} [deg]" for i in range(1, 7)]),
        **points_of(T[:, :3, 3], ["x [mm]", "y [mm]", "z [mm]"]),
    }
    quaternion = dict(zip(("qw", "qx", "qy", "qz"), turned.T, strict=True))
    first = written(columns | quaternion)
    project = begun(tmp_path, kept(tmp_path / "first", {"a.csv": first}))
    (path,) = kept(tmp_path / "second", {"b.csv": written(columns)})
    with refused("missing-column", "orientation", "--leave-out qw,qx,qy,qz"):
        new_readings(path, project.inputs, project.mechanism, whole=True)


def test_so_it_is_where_the_project_reads_the_first_file_itself(tmp_path: Path) -> None:
    (q, T), (later, there) = day(slice(0, 40)), day(slice(60, 80))
    names, coordinates = [f"J{i} [deg]" for i in range(1, 7)], [f"{c} [mm]" for c in "xyz"]
    first = written(joints_of(q, names) | points_of(T[:, :3, 3], coordinates))
    project = begun(tmp_path, kept(tmp_path / "first", {"a.csv": first}))
    assert "source" not in project.inputs["data"]
    names, coordinates = [f"j{i} (rad)" for i in range(1, 7)], [f"{c}_m" for c in "XYZ"]
    columns = joints_of(later, names, 1.0) | points_of(there[:, :3, 3], coordinates, 1.0)
    (tmp_path / "b.csv").write_text(written(columns), "utf-8")
    read = read_new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose([read[n] for n in project.mechanism.joints], later.T, atol=1e-8)
    np.testing.assert_allclose(read["x"], there[:, 0, 3], atol=1e-8)
    mine = [name.replace("j", "axis") for name in names]
    columns = joints_of(later, mine, 1.0) | points_of(there[:, :3, 3], coordinates, 1.0)
    (tmp_path / "c.csv").write_text(written(columns), "utf-8")
    with refused("missing-column", "J1 [deg]"):
        read_new_readings(tmp_path / "c.csv", project.inputs, project.mechanism, whole=True)


def test_a_missing_column_of_the_instrument_is_named(tmp_path: Path) -> None:
    first, (q, T) = day(slice(0, 40)), day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", comma(*first)))
    (tmp_path / "b.csv").write_text(written(joints_of(q) | points_of(T[:, :2, 3], "xy")), "utf-8")
    with refused("missing-column", "z"):
        read_new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)
    assert len(read_new_readings(tmp_path / "b.csv", project.inputs, project.mechanism)) == 20


def test_a_missing_column_of_the_joints_is_named_without_a_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, (q, T) = day(slice(0, 40)), day(slice(60, 80))
    project = begun(tmp_path, kept(tmp_path / "first", plain(*first)))
    columns = joints_of(q) | {"J7": 30.0 * np.cos(q[:, 0])} | points_of(T[:, :3, 3])
    del columns["J6"]
    (tmp_path / "b.csv").write_text(written(columns), "utf-8")
    monkeypatch.setattr(
        "loopcal.workflow.beginning.later_layout.understood", lambda *_: pytest.fail("it searches")
    )
    with refused("missing-column", "J6"):
        new_readings(tmp_path / "b.csv", project.inputs, project.mechanism, whole=True)


def test_the_sixth_joint_of_s_l_u_r_b_t_is_no_time(tmp_path: Path) -> None:
    """In two files, read by what `init` stated of their columns; T rises in small steps."""
    q, T = day(slice(0, 80))
    order = np.argsort(q[:, 5])

    def files(rows: Array) -> dict[str, str]:
        joints = written({"pose": ids(rows), **joints_of(q[rows], [*"SLURBT"], 1.0)})
        return {
            "joints.csv": joints,
            "points.csv": written({"pose": ids(rows), **points_of(T[rows, :3, 3])}),
        }

    project = begun(tmp_path, kept(tmp_path / "first", files(np.arange(40))))
    paths = kept(tmp_path / "second", files(order))
    read = new_readings(paths, project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose(read[project.mechanism.tape.quantities[5]], q[order, 5], atol=1e-8)


def test_joints_of_other_names_are_computed_as_on_the_first_day(tmp_path: Path) -> None:
    def from_the_horizon(q: Array, names: list[str], factor: float = 180 / np.pi) -> dict[str, Any]:
        read = q.copy()
        read[:, 2] -= q[:, 1]
        return joints_of(read, names, factor)

    first, (q, T) = day(slice(0, 40)), day(slice(60, 80))
    columns = from_the_horizon(first[0], NAMES) | points_of(first[1][:, :3, 3])
    project = begun(
        tmp_path, kept(tmp_path / "first", {"a.csv": written(columns)}), "J1,J2,J3+J2,J4,J5,J6"
    )
    names = [f"axis_{i}" for i in range(1, 7)]
    columns = from_the_horizon(q, names, 1.0) | points_of(T[:, :3, 3])
    (path,) = kept(tmp_path / "second", {"b.csv": written(dict(reversed(columns.items())))})
    read = new_readings(path, project.inputs, project.mechanism, whole=True)
    np.testing.assert_allclose([read[n] for n in NAMES], q.T, atol=1e-8)
    assert "axis_3+axis_2" in read.source.read_as
