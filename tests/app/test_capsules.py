"""The body of a machine: each capsule encloses its line at one distance, and is closed."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np

from loopcal.companions.app.pictures import Errors, machine_figure
from loopcal.companions.app.scene import THICK, Scene, capsules, vertices
from loopcal.files.machines.registry import machine_type
from loopcal.report.source import read_source
from tests.command_line import run_here as run
from tests.reference import dh_arm

POINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.6, 0.8, 1.0]])


def distance(corners: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    along = end - begin
    share = np.clip((corners - begin) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(corners - begin - share[:, None] * along, axis=1)


def test_corners_lie_at_one_radius_about_their_line_and_a_point_has_no_body() -> None:
    first, none, last = vertices(POINTS).reshape(3, -1, 3)
    radius = THICK * 2.0
    np.testing.assert_allclose(distance(first, POINTS[0], POINTS[1]), radius, atol=1e-12)
    np.testing.assert_allclose(distance(last, POINTS[2], POINTS[3]), radius, atol=1e-12)
    assert np.ptp(none, axis=0).max() == 0.0


def test_the_surface_is_closed_and_stays_where_the_machine_moves() -> None:
    mesh = capsules(POINTS)
    edges = Counter(
        frozenset(pair)
        for a, b, c in zip(mesh["i"], mesh["j"], mesh["k"], strict=True)
        for pair in ((a, b), (b, c), (c, a))
    )
    size = len(mesh["x"]) // 3
    ends = (*range(12), *range(size - 12, size))  # rings of no radius: poles
    rim = {n + line * size for line in range(3) for n in ends}
    inner = {edge for edge in edges if not edge <= rim}
    assert all(edges[edge] == 2 for edge in inner)
    other = capsules(POINTS[::-1] * 2.0)
    assert [other[k] for k in "ijk"] == [mesh[k] for k in "ijk"]


def test_lines_parted_by_nan_have_no_capsule_between_them() -> None:
    parted = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan] * 3, [0, 1, 0], [1, 1, 0]])
    corners = vertices(parted)
    assert np.isfinite(corners).all()
    _, one, two, _ = corners.reshape(4, -1, 3)
    assert np.ptp(one, axis=0).max() == np.ptp(two, axis=0).max() == 0.0


def test_the_machine_in_space_stands_in_the_first_selected_pose(tmp_path: Path) -> None:
    """Its end lies where that pose was measured, and no selection changes the axes."""
    dh_arm.write_slipped(tmp_path)
    begin = ("init", "poses.csv", "--urdf", "arm.urdf", "--out", ".")
    assert run(*begin, cwd=tmp_path).returncode == 0
    line = ("calibrate", "project.toml", "--method", "least-squares", "--no-report")
    assert run(*line, cwd=tmp_path).returncode in (0, 4)
    source = read_source(tmp_path / "project-result")
    figures = []
    for pose in (3, 40):
        errors = Errors.of(source, selected=[pose, 50])
        assert errors is not None
        figure = errors.in_space()
        assert figure is not None
        body = np.array([figure["data"][2][k] for k in "xyz"])
        measured = np.array([source.table.readings[k][pose] for k in "xyz"])
        assert np.linalg.norm(body - measured[:, None], axis=0).min() < 0.12  # its radius
        posing = errors.posing(pose)
        assert posing is not None
        update, traces = posing
        assert traces == [2]
        np.testing.assert_array_equal(np.array([update[k][0] for k in "xyz"]), body)
        figures.append(figure["layout"]["scene"])
    assert figures[0] == figures[1]


def test_joints_on_the_spot_share_a_label_and_no_joint_lacks_one() -> None:
    arm = machine_type("motoman-ma1400").make()
    drawn = machine_figure(Scene(arm), dict.fromkeys(arm.joints, 0.0))
    assert drawn is not None
    points = drawn["data"][0]
    labels = [
        (text, at) for text, *at in zip(*(points[k] for k in ("text", "x", "y", "z")), strict=False)
    ]
    shown = [label for label in labels if label[0]]
    assert ", ".join(text for text, _ in shown) == ", ".join([*arm.joints, "end point"])
    apart = [np.linalg.norm(np.subtract(a, b)) for (_, a), (_, b) in pairwise(shown)]
    assert min(apart) > 0.1  # [m]: an arm of 2 m in a figure of 420 pixels
