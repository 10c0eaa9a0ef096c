"""Closed forms against poses written down beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.estimation.cameras.board_pose import board_poses
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.hand_eye import METHODS, Method, translations
from loopcal.estimation.cameras.homography import focal_length, homographies
from loopcal.estimation.cameras.pixels import by_point, by_value, pixels, rays
from loopcal.estimation.cameras.placing import Reading, view_poses
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from tests.estimation.cameras.truth import motion, shots

LENSES = [
    Intrinsics("pinhole", 900.0, 910.0, 400.0, 300.0),
    Intrinsics("brown5", 900.0, 910.0, 400.0, 300.0, (-0.2, 0.05, 1e-3, -1e-3, 0.01)),
    Intrinsics("fisheye", 500.0, 500.0, 400.0, 300.0, (0.02, -0.01, 2e-3, -1e-3)),
]


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.lens)
def test_rays_are_the_inverse_of_pixels(lens: Intrinsics) -> None:
    x = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    uv = pixels(lens.lens, np.column_stack([x, np.ones(50)]), lens.values)
    np.testing.assert_allclose(rays(lens, uv), x, atol=1e-10)


def test_views_have_one_pose_whatever_the_hand_does_and_another_of_other_corners() -> None:
    true, lenses = shots(3), (LENSES[0],)
    poses = view_poses(Reading(true.corners, true.T, lenses))
    same = true.corners.at(true.corners.uv.copy())
    assert view_poses(Reading(same, None, lenses, held=False)) is poses
    assert not poses.T_camera_board.flags.writeable
    moved = true.corners.at(true.corners.uv + 1.0)
    others = ((moved, lenses), (true.corners, (LENSES[1],)))
    for corners, of in others:
        other = view_poses(Reading(corners, None, of)).T_camera_board
        assert not np.array_equal(other, poses.T_camera_board)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.lens)
def test_derivatives_of_many_points_are_those_of_each(lens: Intrinsics) -> None:
    """They are taken in parts."""
    P = np.random.default_rng(4).uniform(-0.4, 0.4, (1203, 3)) + np.array([0.0, 0.0, 1.5])
    names = tuple(lens.values)
    every = by_point(lens.lens, P, lens.values), by_value(lens.lens, P, lens.values, names)
    for part in (slice(0, 1), slice(499, 501), slice(1100, 1203)):
        one = by_point(lens.lens, P[part], lens.values)
        np.testing.assert_array_equal(every[0][part], one)
        one = by_value(lens.lens, P[part], lens.values, names)
        np.testing.assert_array_equal(every[1][part], one)
    assert by_value(lens.lens, P, lens.values, ()).shape == (1203, 2, 0)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.lens)
def test_derivatives_are_differences(lens: Intrinsics) -> None:
    P = np.random.default_rng(2).uniform(-0.4, 0.4, (5, 3)) + np.array([0.0, 0.0, 1.5])
    h = 1e-5
    moved = [P + h * e for e in np.eye(3)]
    differences = [
        (pixels(lens.lens, Q, lens.values) - pixels(lens.lens, P, lens.values)) / h for Q in moved
    ]
    np.testing.assert_allclose(
        by_point(lens.lens, P, lens.values), np.stack(differences, axis=2), atol=0.1
    )
    (by_cx,) = by_value(lens.lens, P, lens.values, ["cx"])[:1]
    np.testing.assert_allclose(by_cx[:, 0], [1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
def test_hand_eye_of_exact_poses(method: Method) -> None:
    random = np.random.default_rng(3)
    X, Y = (motion(random.normal(0.0, 1.0, 3), random.normal(0.0, 0.3, 3)) for _ in "XY")
    A = np.array(
        [motion(random.normal(0.0, 0.7, 3), random.normal(0.0, 0.5, 3)) for _ in range(12)]
    )
    C, every = X @ A @ Y, np.ones(12)
    ((R_X, R_Y),) = method(A, C, every)
    solution = translations(A, C, every, R_X, R_Y, scaled=True)
    np.testing.assert_allclose(solution.X, X, atol=1e-9)
    np.testing.assert_allclose(solution.Y, Y, atol=1e-9)
    assert solution.scale == pytest.approx(1.0)


@pytest.mark.parametrize("factor", [1000.0, -1.0])
def test_scale_of_positions(factor: float) -> None:
    random = np.random.default_rng(4)
    X, Y = (motion(random.normal(0.0, 1.0, 3), random.normal(0.0, 0.3, 3)) for _ in "XY")
    A = np.array(
        [motion(random.normal(0.0, 0.7, 3), random.normal(0.0, 0.5, 3)) for _ in range(12)]
    )
    C = X @ A @ Y
    A[:, :3, 3] /= factor
    solution = translations(A, C, np.ones(12), X[:3, :3], Y[:3, :3], scaled=True)
    assert solution.scale == pytest.approx(factor)


def test_focal_length_of_tilted_boards() -> None:
    true = shots(5, noise=0.0)
    corners, lens = true.corners, true.intrinsics["cam"]
    straight = rays(lens, corners.uv) * true.f + np.array([lens.cx, lens.cy])
    H, _ = homographies(corners.views, corners.xyz[:, :2], straight)
    assert focal_length(H, np.array([lens.cx, lens.cy])) == pytest.approx(true.f, rel=1e-5)


def test_a_plane_has_two_poses_and_the_better_one_is_true() -> None:
    true = shots(6, noise=0.0)
    poses = board_poses(true.corners, rays(true.intrinsics["cam"], true.corners.uv))
    np.testing.assert_allclose(poses.T_camera_board[:, 0], true.X @ true.T @ true.Y, atol=1e-7)
    # Near the camera the second one may have no minimum of its own.
    assert np.median(poses.error[:, 1]) > 1e-3


def test_a_body_of_points_from_any_side() -> None:
    random = np.random.default_rng(7)
    xyz = random.normal(0.0, 0.05, (8, 3))
    board = Board("body", {str(k): tuple(p) for k, p in enumerate(xyz.tolist())})
    R = Rotation.random(10, random_state=7).as_matrix()
    P = xyz @ R.transpose(0, 2, 1) + np.array([0.1, 0.0, 1.0])
    index = [np.repeat(np.arange(10), 8), np.zeros(80), np.zeros(80), np.tile(np.arange(8), 10)]
    ray = (P[:, :, :2] / P[:, :, 2:]).reshape(-1, 2)
    corners = Corners.of(
        [i.astype(np.intp) for i in index], ray, ["cam"], [board], list("abcdefghij")
    )
    poses = board_poses(corners, corners.uv)
    np.testing.assert_allclose(poses.T_camera_board[:, 0, :3, :3], R, atol=1e-6)
