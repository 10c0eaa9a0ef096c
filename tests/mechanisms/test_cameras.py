"""Lenses project as OpenCV does, and printed boards have the points that they should."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.mechanisms.cameras import printed
from loopcal.mechanisms.cameras.lens import LENSES, Intrinsics, project, turning_radius
from tests.refusals import refused

DISTORTION = {
    "pinhole": (),
    "brown5": (-0.21, 0.06, 1.2e-3, -0.8e-3, -0.01),
    "brown8": (0.3, -0.1, 1e-3, 2e-3, 0.02, 0.5, -0.05, 0.03),
    "brown12": (0.3, -0.1, 1e-3, 2e-3, 0.02, 0.5, -0.05, 0.03, 1e-3, -2e-3, 3e-3, 1e-4),
    "fisheye": (-0.03, 0.01, -0.004, 0.0006),
}


def camera(lens: str) -> Intrinsics:
    """A camera of 1600 x 1200 pixels with this lens."""
    return Intrinsics(lens, 1352.0, 1356.5, 789.7, 627.3, DISTORTION[lens], (1600, 1200))


def points(number: int = 200) -> np.ndarray:
    """(3, number) [m] in front of the camera, up to half a right angle off its axis."""
    random = np.random.default_rng(7)
    z = random.uniform(0.5, 3.0, number)
    return np.array([*(random.uniform(-0.6, 0.6, (2, number)) * z), z])


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_are_those_of_opencv(lens: str) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (loopcal[images])")
    one, xyz = camera(lens), points()
    K = np.array([[one.fx, 0.0, one.cx], [0.0, one.fy, one.cy], [0.0, 0.0, 1.0]])
    D, still = np.array(one.distortion), np.zeros(3)
    if lens == "fisheye":
        seen, _ = cv2.fisheye.projectPoints(xyz.T.reshape(-1, 1, 3), still, still, K, D)
    else:
        seen, _ = cv2.projectPoints(xyz.T, still, still, K, D if len(D) else None)
    np.testing.assert_allclose(
        np.array(project(lens, xyz, one.values)), seen.reshape(-1, 2).T, rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("lens", LENSES)
def test_on_the_axis_a_lens_is_its_focal_length(lens: str) -> None:
    one, h = camera(lens), 1e-6
    at = np.array([[0.0, h, -h, 0.0, 0.0], [0.0, 0.0, 0.0, h, -h], np.ones(5)])
    u, v = project(lens, at, one.values)
    assert np.allclose((u[0], v[0]), (one.cx, one.cy), atol=1e-9)
    slopes = np.array([(u[1] - u[2], v[1] - v[2]), (u[3] - u[4], v[3] - v[4])]) / (2.0 * h)
    np.testing.assert_allclose(slopes, np.diag([one.fx, one.fy]), atol=1e-4)


def test_a_lens_turns_back_where_its_derivative_vanishes() -> None:
    values = Intrinsics("brown5", 1.0, 1.0, 0.0, 0.0, (-0.2, 0.0, 0.0, 0.0, 0.0)).values
    assert np.isclose(turning_radius("brown5", values), np.sqrt(1.0 / 0.6))
    assert turning_radius("pinhole", {}) == np.inf


def test_a_checkerboard_has_its_inner_corners_row_by_row() -> None:
    board = printed.checkerboard(3, 2, (0.02, 0.03))
    assert board.points["0"] == (0.0, 0.0, 0.0)
    assert np.allclose(board.points["4"], (0.02, 0.03, 0.0))
    assert list(board.points) == ["0", "1", "2", "3", "4", "5"]


def test_a_charuco_board_has_the_corners_of_opencv() -> None:
    board = printed.charuco((5, 7), 0.036195, 0.018256, "6X6_250", legacy=True)
    assert len(board.points) == 24
    assert np.allclose(board.points["5"], (2 * 0.036195, 2 * 0.036195, 0.0))
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (loopcal[images])")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    other = cv2.aruco.CharucoBoard((5, 7), 0.036195, 0.018256, dictionary).getChessboardCorners()
    np.testing.assert_allclose(board.xyz, other, atol=1e-7)


def test_tags_are_counted_from_the_bottom_left_and_their_corners_too() -> None:
    board = printed.aprilgrid(3, 2, 0.1, 0.3)
    assert len(board.points) == 24
    assert np.allclose(board.points["0.2"], (0.1, 0.1, 0.0))
    assert np.allclose(board.points["4.0"], (0.13, 0.13, 0.0))
    assert np.allclose(board.points["4.1"], (0.23, 0.13, 0.0))


def test_rows_of_asymmetric_circles_are_shifted() -> None:
    board = printed.circles(2, 3, 0.01, asymmetric=True)
    assert np.allclose(
        board.xyz[:, :2], np.array([(0, 0), (2, 0), (1, 1), (3, 1), (0, 2), (2, 2)]) / 100
    )


def test_boards_of_no_size_are_refused() -> None:
    with refused("invalid-value", "'wall'"):
        printed.checkerboard(3, 2, 0.0, "wall")
    with refused("invalid-value", "0 x 2"):
        printed.circles(0, 2, 0.01)
