"""A project from corners: of a camera in the hand, and of boards that no robot holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.document.accuracy import ValidationEntry
from loopcal.mechanisms.cameras.lens import project
from loopcal.statistics.verdict import findings_of
from loopcal.workflow.beginning.images_project import frame_of
from tests.mechanisms.test_camera import LENS, POINTS, hands, pixels
from tests.refusals import refused


def written(
    folder: Path,
    uv: np.ndarray,
    T: np.ndarray | None,
    points: Mapping[str, tuple[float, float, float]] = POINTS,
) -> Path:
    """A folder of a board, of corners (points, 2, N) and, where a robot holds one, its poses."""
    rows = ["board,point,x_m,y_m,z_m"]
    rows += [f"board,{p},{x},{y},{z}" for p, (x, y, z) in points.items()]
    (folder / "points.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    rows = ["pose,camera,board,point,u_px,v_px"]
    for point, (u, v) in zip(points, uv, strict=True):
        rows += [
            f"{i},1,board,{point},{a:.5f},{b:.5f}"
            for i, (a, b) in enumerate(zip(u, v, strict=True))
        ]
    (folder / "corners.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    if T is not None:
        rows = ["pose,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
        for i, pose in enumerate(T):
            x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
            place = (*(1e3 * pose[:3, 3]), w, x, y, z)
            rows.append(",".join([str(i), *(f"{v:.9f}" for v in place)]))
        (folder / "robot.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("robot", [True, False])
def test_a_folder_becomes_a_project_that_finds_the_lens(tmp_path: Path, robot: bool) -> None:
    T = hands(24, 5)
    noise = np.random.default_rng(6).normal(0.0, 0.1, (len(POINTS), 2, 24))
    folder = tmp_path / "images"
    folder.mkdir()
    written(folder, pixels(T, on="base") + noise, T if robot else None)
    project = lc.init(folder, out=tmp_path / "calibration")
    assert "24 images with 288 corners" in str(project)
    kind = project.mechanism.description
    assert kind is not None
    assert kind.get("read", True) == robot
    result = lc.calibrate(tmp_path / "calibration" / "project.toml", method="implicit-loop")
    (f,) = [p for p in result.document.parameters if p.name == "camera_1_f"]
    assert f.sd is not None
    assert abs(f.value - LENS.fx) < 4.0 * f.sd
    assert f.sd < 0.05 * LENS.fx
    document = result.document
    assert document.accuracy is not None
    assert bool(document.accuracy.places) == robot  # a board that nobody holds is where it is seen
    held = ValidationEntry({}, "", 24, document.accuracy.after, None)
    held = replace(held, places=document.accuracy.places)
    for tolerance, robot_code in ((10e-3, "within-tolerance"), (1e-5, "outside-tolerance")):
        codes = [one.code for one in findings_of(replace(document, validation=held), tolerance)]
        assert (robot_code if robot else "unknown-accuracy") in codes


@pytest.mark.parametrize("turns", [False, True])
def test_positions_alone_are_those_of_a_hand_that_never_turns(tmp_path: Path, turns: bool) -> None:
    """As of a gantry. Where the boards turn in the images, the cameras alone are calibrated."""
    T = hands(16, 64320)
    if not turns:
        T[:, :3, :3] = np.eye(3)
    noise = np.random.default_rng(6).normal(0.0, 0.1, (len(POINTS), 2, len(T)))
    folder = tmp_path / "images"
    folder.mkdir()
    written(folder, pixels(T, on="base") + noise, T)
    rows = [line.split(",")[:4] for line in (folder / "robot.csv").read_text("utf-8").splitlines()]
    (folder / "robot.csv").write_text("\n".join(map(",".join, rows)) + "\n", "utf-8")
    project = lc.init(folder, out=tmp_path / "calibration")
    kind = project.mechanism.description
    assert kind is not None
    assert kind.get("read", True) != turns
    assert ("and no turns: it never turns" in str(project)) != turns
    assert ("states no pose of a flange" in str(project)) == turns
    assert ("the hand is turned alike" in str(project)) != turns


@pytest.mark.parametrize("sized", [False, True])
def test_points_of_a_body_are_told_from_its_place(sized: bool) -> None:
    """No small motion of the body, nor where `sized` a growth, leaves what is held at rest."""
    for seed in range(60210, 60220):
        random = np.random.default_rng(seed)
        xyz = random.uniform(-0.2, 0.2, (9, 3))
        seen = np.full(9, 30)
        seen[3] = 4
        held = frame_of(xyz, seen, sized=sized)
        assert len(held) == 6 + sized
        assert 3 not in {point for point, _ in held}
        motions = [np.tile(t, (9, 1)) for t in np.eye(3)]
        motions += [np.cross(w, xyz) for w in np.eye(3)] + [xyz] * sized
        moved = np.array([[motion[at] for motion in motions] for at in held])
        assert np.linalg.cond(moved) < 1e3


def test_points_of_a_body_are_determined_without_priors(tmp_path: Path) -> None:
    """Least squares has none: where the body stands and where its points are on it move alike."""
    random = np.random.default_rng(60221)
    xyz = random.uniform([0.0, 0.0, 0.0], [0.2, 0.2, 0.08], (10, 3))
    points = {f"P{i}": (float(x), float(y), float(z)) for i, (x, y, z) in enumerate(xyz)}
    T = hands(24, 60221)
    uv = pixels(T, on="base", points=points)
    written(tmp_path, uv + random.normal(0.0, 0.1, uv.shape), T, points)
    project = lc.init(tmp_path)
    result = lc.calibrate(project.mechanism, project.dataset, method="least-squares")
    assert not result.document.identifiability.loose


def test_corners_without_a_board_are_refused(tmp_path: Path) -> None:
    T = hands(4, 5)
    folder = written(tmp_path, pixels(T, on="base"), T)
    (folder / "points.csv").unlink()
    with refused("missing-key", "board"):
        lc.init(folder)


def test_cameras_alone_are_judged_by_images_and_not_sent_to_plan(tmp_path: Path) -> None:
    """Two cameras in one place before a board that nobody holds."""
    T, random = hands(24, 5), np.random.default_rng(8)
    uv = [pixels(T, on="base") + random.normal(0.0, 0.1, (len(POINTS), 2, 24)) for _ in range(2)]
    written(tmp_path, uv[0], None)
    rows = [
        f"{i},2,board,{point},{u:.5f},{v:.5f}"
        for point, (us, vs) in zip(POINTS, uv[1], strict=True)
        for i, (u, v) in enumerate(zip(us, vs, strict=True))
    ]
    with (tmp_path / "corners.csv").open("a", encoding="utf-8") as file:
        file.write("\n".join(rows) + "\n")
    project = lc.init(tmp_path)
    result = lc.calibrate(project.mechanism, project.dataset, noise=project.noise)
    assert result.document.validation is not None
    codes = [one.code for one in result.document.findings]
    # The pose that both see is free: their residuals are never independent.
    assert "errors-shared" not in codes
    assert "valid-in-image" in codes
    assert "joint space" not in result.document.validation.words
    advised = [one.next for one in result.document.findings if one.next]
    assert not any("loopcal plan" in (one.command or "") for one in advised)


ORIGINS = ((0.0, 0.0, 0.0), (-1.57, 0.0, 0.0), (0.0, 0.0, 0.0), (-1.57, 0.0, 0.0), (1.57, 0.0, 0.0))
"""Turns of the links of an arm, each of which is 0.3 m from the one before."""


def _forearm(folder: Path, count: int) -> None:
    """Images of a board on the fourth of five links, and the URDF of the arm."""
    folder.mkdir()
    links = [
        f'<joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/><child link='
        f'"link_{k}"/><origin xyz="0.3 0 0.05" rpy="{r} {p} {y}"/><axis xyz="0 0 1"/><limit '
        f'lower="-3" upper="3" effort="0" velocity="1"/></joint><link name="link_{k}"/>'
        for k, (r, p, y) in enumerate(ORIGINS, 1)
    ]
    arm = f'<robot name="arm"><link name="link_0"/>{"".join(links)}</robot>'
    (folder / "arm.urdf").write_text(arm, "utf-8")
    rng = np.random.default_rng(7)
    q = rng.uniform(-0.25, 0.25, (count, 5)) * [1.0, 1.0, 1.0, 1.0, 8.0]
    q[0] = 0.0
    T = np.eye(4)
    for k, turn in enumerate(ORIGINS[:4]):
        step = np.tile(np.eye(4), (count, 1, 1))
        about = Rotation.from_rotvec(np.outer(q[:, k], [0.0, 0.0, 1.0]))
        step[:, :3, :3] = (Rotation.from_euler("xyz", turn) * about).as_matrix()
        step[:, :3, 3] = [0.3, 0.0, 0.05]
        T = T @ step
    first = np.eye(4)
    first[:3, 3] = [-0.05, -0.04, 1.0]
    board = np.array([(*p, 1.0) for p in POINTS.values()]).T
    P = (first @ np.linalg.inv(T[0]) @ T @ board).transpose(1, 0, 2)[:3]
    uv = np.array(project(LENS.lens, P, LENS.values)).transpose(2, 0, 1)
    written(folder, uv + rng.normal(0.0, 0.1, uv.shape), None)
    rows = [",".join(map(str, [i, *joints])) for i, joints in enumerate(q)]
    head = ",".join(["pose", *(f"joint_{k} [rad]" for k in range(1, 6))])
    (folder / "joints.csv").write_text("\n".join([head, *rows]) + "\n", "utf-8")


def test_the_link_that_carries_the_board_is_the_one_that_fits(tmp_path: Path) -> None:
    _forearm(tmp_path / "images", 14)
    begun = lc.init(tmp_path / "images")
    assert [q for q in begun.dataset.readings if "joint" in q] == [
        f"joint_{k}" for k in range(1, 5)
    ]
    assert any("'link_5'" in words and "'link_4'" in words for words in begun.remarks)


def test_poses_that_explain_nothing_are_refused(tmp_path: Path) -> None:
    T = hands(12, 5)
    uv = pixels(T, on="base") + np.random.default_rng(6).normal(0.0, 0.1, (len(POINTS), 2, 12))
    written(tmp_path, uv, T[np.random.default_rng(7).permutation(12)])
    with refused("mismatched-poses", "order of the rows"):
        lc.init(tmp_path)
