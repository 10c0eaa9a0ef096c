"""A grid encoder, or a camera above a table, reads x and y of a point alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.cli.run import main
from loopcal.mechanisms.skeleton import skeleton
from loopcal.report.sighted import sightings
from tests.refusals import refused

Array = NDArray[np.float64]
NOISE = 2e-5
SCARA = """joint,a [mm],d [mm],alpha [deg],theta [deg],type
J1,300,200,0,0,revolute
J2,250,0,180,0,revolute
J3,0,0,0,0,prismatic
J4,0,50,0,0,revolute
"""
OFF = (4e-4, -3e-4)
"""By how much the links of the real machine are longer [m]."""
LEVEL, ASKEW, BELOW = np.eye(3), Rotation.from_euler("ZYX", [0.3, 0.4, 0.5]), np.diag([1, -1, -1])


def table(rng: np.random.Generator, stands: Array, rows: int = 30) -> dict[str, Array]:
    """Joints of the SCARA and x, y of a point of its tool, 30 and 10 mm off the last axis."""
    q1, q2, z, q4 = rng.uniform([-2, 0.3, 0, -3], [2, 2.3, 0.15, 3], (rows, 4)).T
    # The second row turns the last two axes over, so that the last joint counts clockwise.
    way, end = q1 + q2, q1 + q2 - q4
    a1, a2 = 0.3 + OFF[0], 0.25 + OFF[1]
    x = a1 * np.cos(q1) + a2 * np.cos(way) + 0.03 * np.cos(end) + 0.01 * np.sin(end)
    y = a1 * np.sin(q1) + a2 * np.sin(way) + 0.03 * np.sin(end) - 0.01 * np.cos(end)
    points = np.array([x, y, 0.2 - z - 0.05]).T @ stands.T + [0.7, -0.4, 0.0]
    seen = points[:, :2] + NOISE * rng.standard_normal((rows, 2))
    turned = {"J1 [deg]": q1, "J2 [deg]": q2, "J4 [deg]": q4}
    joints = {n: np.degrees(v) for n, v in turned.items()} | {"J3 [mm]": 1e3 * z}
    return joints | {"X [mm]": 1e3 * seen[:, 0], "Y [mm]": 1e3 * seen[:, 1]}


@pytest.mark.parametrize(
    "stands", [LEVEL, ASKEW.as_matrix(), BELOW], ids=["level", "askew", "below"]
)
def test_an_arm_in_space_is_begun_from_x_and_y(tmp_path: Path, stands: Array) -> None:
    rng = np.random.default_rng(41)
    (tmp_path / "dh.csv").write_text(SCARA)
    made = lc.init(table(rng, stands), dh=tmp_path / "dh.csv", out=tmp_path)
    assert made.mechanism.outputs == ("x", "y")
    assert "base_z" not in made.mechanism.parameters.names
    fit = lc.calibrate(lc.read_project(tmp_path / "project.toml"), method="implicit-loop")
    for name, off in zip(("a_1", "a_2"), OFF, strict=True):
        p = fit.params[name]
        assert p.sd is not None
        assert abs(p.value - p.nominal - off) < 4.0 * p.sd < 0.5e-3
    drawn = skeleton(fit.mechanism, dict.fromkeys(fit.mechanism.joints, 0.1))
    (seen,) = sightings(fit.mechanism, fit.dataset.readings, fit.differences_after)
    assert drawn is not None
    assert drawn.shape[1] == len(seen.at) == 3  # arrows and machine stand in one figure
    later = table(rng, stands @ Rotation.from_euler("z", 0.5).as_matrix(), 12)
    assert lc.verify(fit, later).verdict["consistent"].passed


def five_bar(tmp_path: Path, mirrored: bool = False) -> Path:
    """Driven joints of a five-bar and x, y of the point where its arms meet."""
    assert main(["new", str(tmp_path / "new"), "--mechanism", "five-bar"]) == 0
    poses = tmp_path / "poses.csv"
    assert main(["simulate", str(tmp_path / "new/project.toml"), "--out", str(poses)]) == 0
    truth = np.genfromtxt(poses, delimiter=",", names=True)
    names = truth.dtype.names or ()
    q1, q2 = (np.radians(truth[n]) for n in names if n.startswith("theta"))
    elbows = [
        np.array([at + 0.25 * np.cos(q), 0.25 * np.sin(q)]) for at, q in ((0.0, q1), (0.25, q2))
    ]
    across = elbows[1] - elbows[0]
    far = np.linalg.norm(across, axis=0)
    height = np.sqrt(0.35**2 - far**2 / 4.0)
    met = elbows[0] + across / 2.0 + height / far * np.array([-across[1], across[0]])
    met += NOISE * np.random.default_rng(42).standard_normal(met.shape)
    met[1] *= -1.0 if mirrored else 1.0
    columns = np.array([np.degrees(q1), np.degrees(q2), *(1e3 * met), *(0.0 * met[:1])]).T
    np.savetxt(
        poses, columns, "%.6f", ",", header="q1 [deg],q2 [deg],x [mm],y [mm],z [mm]", comments=""
    )
    return poses


def test_closed_loops_in_a_plane_are_begun_from_x_and_y(tmp_path: Path) -> None:
    poses = five_bar(tmp_path)
    with refused("unsupported", "moves in a plane") as caught:
        lc.init(poses, machine="five-bar")
    assert caught.value.options == ("--leave-out", "z [mm]")
    made = lc.init(poses, machine="five-bar", leave_out="z [mm]", out=tmp_path / "out")
    assert made.rms < 2.0 * NOISE
    assert {"tool_x", "tool_y"} <= {*made.mechanism.parameters.names}
    assert "tool_z" not in made.mechanism.parameters.names
    fit = lc.calibrate(lc.read_project(tmp_path / "out/project.toml"), method="implicit-loop")
    assert fit.status.converged
    distal = fit.params["distal_1"]
    assert distal.sd is not None
    assert abs(distal.value - 0.35) < 4.0 * distal.sd


def test_a_mirrored_frame_of_a_machine_in_a_plane_is_refused(tmp_path: Path) -> None:
    with refused("implausible-readings", "left-handed") as caught:
        lc.init(five_bar(tmp_path, mirrored=True), machine="five-bar", leave_out="z*")
    assert caught.value.options == ("--joints", "-q1 [deg],-q2 [deg]")
