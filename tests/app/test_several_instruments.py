"""A machine that several trackers see in their own readings: one error and one place per pose."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from loopcal.companions.app.beside import SIZE, errors_by_name
from loopcal.companions.app.pictures import Errors, joints_of
from loopcal.companions.app.predicting import Probe
from loopcal.companions.app.session import Session
from loopcal.companions.app.view import View
from loopcal.companions.app.views.data import corners_read
from loopcal.companions.app.views.deploy import limbs_of
from loopcal.document.result_document import MechanismEntry
from loopcal.files.project.project_file import read_project
from loopcal.files.result.pose_table import PoseTable
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.bodies import Hanging, tree_machine
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.outputs import cartesian, levers, point_family, seen_outputs
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.report.drawn import distances
from loopcal.report.source import Source, read_source
from tests.app.plain_command import command
from tests.command_line import run_here as run


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Source:
    folder = tmp_path_factory.mktemp("trackers") / "arm"
    project = folder / "project.toml"
    assert run("new", folder, "--mechanism", "serial-trackers").returncode == 0
    project.write_text(project.read_text("utf-8").replace('"auto" ', '"implicit-loop" '), "utf-8")
    done = run("simulate", project, "--out", folder / "poses.csv", "--seed", "1")
    assert done.returncode == 0, done.stderr
    done = run("calibrate", project, "--no-report")
    assert done.returncode == 0, done.stderr
    return read_source(folder / "project-result")


def readings(source: Source, tracker: str) -> np.ndarray:
    names = [f"{tracker}_{what}" for what in ("range", "azimuth", "elevation")]
    return np.array([source.table.readings[name] for name in names])


def test_the_error_of_a_pose_is_the_rms_over_its_instruments(source: Source) -> None:
    errors = Errors.of(source)
    assert errors is not None
    each = distances(source, source.table.differences_after).reshape(2, -1) * 1e3
    assert np.allclose(errors.size, np.sqrt(np.square(each).mean(axis=0)))
    assert errors.over_poses()["data"][0]["customdata"] == list(range(60))


def test_each_instrument_has_errors_in_its_unit(source: Source) -> None:
    errors = Errors.of(source)
    assert errors is not None
    east, west = distances(source, source.table.differences_after).reshape(2, -1) * 1e3
    np.testing.assert_allclose(errors.shown["east"], east)
    np.testing.assert_allclose(errors.shown["west"], west)
    assert list(errors.units) == list(errors.shown)
    assert set(errors.units.values()) == {"mm"}
    assert errors.over_poses("east")["layout"]["yaxis"]["title"]["text"] == "error of east [mm]"


def test_a_warm_up_is_drawn_as_a_curve(source: Source) -> None:
    """Through errors that settle exponentially, close at both ends; none where nothing is slow."""
    settled = np.exp(-np.arange(60) / 8.0)
    names = list(source.table.differences_after)
    rng = np.random.default_rng(2)
    off = {name: np.zeros(60) for name in names}
    off["east_range"] = 1e-3 * settled + rng.normal(0.0, 2e-5, 60)
    errors = Errors.of(source, differences=off, slow=True)
    assert errors is not None
    points, curve = errors.over_poses("east")["data"]
    at, expected = np.array(points["x"]), settled
    drawn = np.interp(at, curve["x"], curve["y"])
    assert np.abs(drawn - expected).max() < 0.08  # of 1 mm
    plain = Errors.of(source, differences=off)
    assert plain is not None
    assert len(plain.over_poses("east")["data"]) == 1


CAMERA = """
schema = 1
[mechanism]
type = "free-body"
[[mechanism.instrument]]
type = "camera"
name = "camera"
eye = "eye"
board = "board"
on = "base"
points = { 0 = [0.0, 0.0, 0.0], 1 = [0.1, 0.0, 0.0], 2 = [0.0, 0.1, 0.0] }
[mechanism.parameters]
eye_f = { value = 1000.0, unit = "px" }
"""


def test_corners_of_images_are_no_joints_and_count_as_one_distance(tmp_path: Path) -> None:
    project = tmp_path / "project.toml"
    project.write_text(CAMERA, "utf-8")
    mechanism = read_project(project).mechanism
    assert joints_of(mechanism) == ["x", "y", "z", "wx", "wy", "wz"]
    moved = Session(tmp_path, command).moved()
    assert [*moved] == ["Camera or board on the robot", "Camera or board in the cell"]
    assert all(name.startswith("board_") for name in next(iter(moved.values())))
    off = np.array([3.0, 4.0, 0.0, 5.0, 0.0, 0.0])[:, None] * [1.0, 2.0]
    off[:, 1][4:] = np.nan  # a corner that was not seen
    differences = dict(zip(mechanism.compared, off, strict=True))
    table = PoseTable(("1", "2"), readings=differences)
    document = SimpleNamespace(mechanism=MechanismEntry.of(mechanism), accuracy=None)
    image = cast("Source", SimpleNamespace(mechanism=mechanism, table=table, document=document))
    shown, units = errors_by_name(image, differences, "px")
    assert units == {SIZE: "px"}
    np.testing.assert_allclose(shown[SIZE], [np.sqrt(50.0 / 3.0), 10.0])
    (seen,) = seen_outputs(mechanism)
    data = Dataset(differences, mechanism.quantities, poses=("1", "2"))
    assert [corners_read(data, i, seen) for i in (0, 1)] == ["3 of 3", "2 of 3"]


def test_poses_are_shown_where_the_first_tracker_saw_them(source: Source) -> None:
    errors = Errors.of(source)
    assert errors is not None
    drawn = errors.in_space()
    assert drawn is not None
    shown = np.array([drawn["data"][0][k] for k in "xyz"], dtype=float)
    at = cartesian(readings(source, "east"))
    assert np.abs(shown - at).max() < 1e-5  # figures round to six digits


def test_the_map_shows_points_and_sds_of_lengths(source: Source) -> None:
    probe = Probe.of(source)
    assert probe is not None
    found = probe.map()
    measured = cartesian(readings(source, "east"))
    middle, reach = measured.mean(axis=1), np.ptp(measured, axis=1).max()
    assert np.abs(found.at - middle[:, None]).max() < 1.5 * reach
    assert source.mechanism is not None
    family = point_family(source.mechanism)
    assert family is not None
    one = readings(source, "east")[:, :1]
    steps = 1e-7 * np.eye(3)
    slopes = [(cartesian(one + h[:, None]) - cartesian(one - h[:, None])) / 2e-7 for h in steps]
    lengths = [np.linalg.norm(slope) for slope in slopes]
    assert np.allclose(levers(family, one)[:, 0], lengths, rtol=1e-6)
    assert float(np.median(found.sd)) < 1e-3


def test_a_robot_of_several_limbs_is_exported_and_corrected_by_one_of_them() -> None:
    def view(mechanism: object) -> View:
        project = SimpleNamespace(mechanism=mechanism)
        return cast(View, SimpleNamespace(session=SimpleNamespace(project=lambda: project)))

    bodies = [Hanging(name, "base", LinkJoint(f"q_{name}", axis=(0.0, 0.0, 1.0))) for name in "ab"]
    robot = assemble(tree_machine(bodies, root="base"), [point("p", on="a", against="b")])
    assert limbs_of(view(robot)) == ("a", "b")
    assert limbs_of(view(assemble(serial_machine([Joint("q1"), Joint("q2")]), [point("p")]))) == ()
