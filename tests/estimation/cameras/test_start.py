"""A start from nothing arrives at the truth, whatever is held by the hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.errors import InputError
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.lens_choice import EVERY
from loopcal.estimation.cameras.start import start
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from tests.estimation.cameras.truth import COLUMNS, motion, pixel, shots


@pytest.mark.parametrize(("held", "stated"), [(True, False), (False, True)])
def test_camera_board_and_lens_from_nothing(held: bool, stated: bool) -> None:
    true = shots(3 + held, held=held)
    begun = true.start(stated=stated, held=None)
    assert begun.held is held
    # Noise of 0.2 px in u and in v: 0.28 px in length.
    assert begun.rms == pytest.approx(0.28, abs=0.02)
    np.testing.assert_allclose(begun.X[0], true.X, atol=3e-3)
    np.testing.assert_allclose(begun.Y[0], true.Y, atol=3e-3)
    assert begun.intrinsics["cam"].fx == pytest.approx(true.f, rel=1e-3)
    assert {fact.code for fact in begun.facts} == {"mount"}


@pytest.mark.parametrize("held", [True, False])
def test_what_would_sit_far_from_the_flange_is_not_on_it(held: bool) -> None:
    """Inverted poses are those of the other mount: the same equations, and the same pixels."""
    true = shots(3 + held, held=held)
    begun = true.start(T=np.linalg.inv(true.T), held=None)
    assert begun.held is held
    assert begun.T_base_flange is not None
    np.testing.assert_allclose(begun.T_base_flange, true.T, atol=1e-9)
    (fact,) = (fact for fact in begun.facts if fact.code == "mount")
    assert "the poses are inverted" in fact.sentence
    assert " m from the flange" in fact.sentence


def test_wrong_corners_do_not_move_it() -> None:
    true = shots(7, wrong=0.1)
    begun = true.start()
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


def test_without_a_robot_lens_and_poses() -> None:
    true = shots(11)
    begun = start(true.corners, None, None, true.sizes)
    assert begun.held is None
    assert begun.intrinsics["cam"].fx == pytest.approx(true.f, rel=0.01)
    np.testing.assert_allclose(
        begun.T_camera_board, true.X @ true.T @ true.Y, atol=0.01 * true.f / 1000.0
    )


def test_each_view_keeps_both_poses_of_a_plane() -> None:
    begun = shots(13).start()
    rows = np.arange(len(begun.chosen))
    near = begun.branches[rows, begun.chosen]
    np.testing.assert_allclose(near[:, :3, :3], begun.T_camera_board[:, :3, :3], atol=0.05)
    other = begun.branches[rows, 1 - begun.chosen]
    # Of a plane near the camera some views have a single minimum.
    assert np.median(np.linalg.norm((near - other)[:, :3, :3], axis=(1, 2))) > 0.5


def test_three_corners_are_refused_where_no_hand_moves_them() -> None:
    true = shots(17)
    few = true.corners.where(true.corners.point < 3)
    with pytest.raises(InputError, match="four corners"):
        start(few, None, true.intrinsics, true.sizes)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_corners_are_placed_by_how_the_hand_moves(count: int) -> None:
    true = shots(17)
    few = true.corners.where(true.corners.point < count)
    begun = start(few, true.T, true.intrinsics, true.sizes, True)
    assert begun.rms < 0.3  # 0.28 less what the unknowns take up
    np.testing.assert_allclose(begun.X[0], true.X, atol=5e-3)
    # Of one point nothing says how its board is turned.
    seen = [
        (Y @ np.append(few.xyz[k], 1.0))[:3] for Y in (begun.Y[0], true.Y) for k in range(count)
    ]
    np.testing.assert_allclose(seen[:count], seen[count:], atol=5e-3)


def test_images_without_a_pose_are_left_out() -> None:
    true = shots(19)
    T = true.T.copy()
    T[4] = np.nan
    begun = true.start(T=T)
    assert 4 not in begun.corners.image
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)


def _two_eyes(seed: int) -> tuple[Corners, dict[str, Intrinsics]]:
    """Two narrow cameras before a body of 20 markers: the left shows four or five of them, the
    right as many in one image of eight, and two otherwise."""
    random = np.random.default_rng(seed)
    g = (1.0 + 5.0**0.5) / 2.0
    signs = [(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    xyz = [(a, b, c) for a, b in signs for c in (-1.0, 1.0)]
    xyz += [p for a, b in signs for p in ((0.0, a / g, b * g), (a / g, b * g, 0.0))]
    xyz += [(b * g, 0.0, a / g) for a, b in signs]
    points = 0.031 * np.array(xyz)
    board = Board("body", {str(k): tuple(p) for k, p in enumerate(points.tolist())})
    first = motion(np.zeros(3), np.zeros(3))
    eyes = [first, motion(np.array([0.0, -0.16, 0.0]), np.array([0.36, 0.0, 0.03]))]
    R = Rotation.from_euler("xyz", random.uniform(-0.15, 0.15, (100, 3))).as_matrix()
    index, uv = [], []
    for i, turn in enumerate(R):
        place = np.array([0.18, 0.0, 1.7]) + random.uniform(-0.1, 0.1, 3)
        for c, eye in enumerate(eyes):
            P = (points @ turn.T + place) @ eye[:3, :3].T + eye[:3, 3]
            normal = points @ turn.T @ eye[:3, :3].T
            facing = -np.sum(normal * P, axis=1) / np.linalg.norm(P, axis=1)
            few = 4 if random.random() < (0.13 if c else 0.8) else 2 if c else 5
            seen = np.argsort(-facing)[:few]
            pixels = pixel(P[seen], 8000.0, np.array([3000.0, 2000.0]))
            index += [(i, c, 0, int(k)) for k in seen]
            uv.append(pixels + random.normal(0.0, 0.4, pixels.shape))
    columns = [np.array(column, dtype=np.intp) for column in zip(*index, strict=True)]
    names = [str(i) for i in range(len(R))]
    corners = Corners.of(columns, np.concatenate(uv), ["left", "right"], [board], names)
    stated = Intrinsics("brown5", 8100.0, 8100.0, 2960.0, 2010.0, (0.0,) * 5, (6000, 4000))
    return corners, {"left": stated, "right": stated}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_cameras_agree_on_the_pose_that_few_markers_leave_open(seed: int) -> None:
    corners, stated = _two_eyes(seed)
    begun = start(corners, None, stated)
    assert "image-unexplained" not in {fact.code for fact in begun.facts}
    assert begun.rms < 0.57
    # One in sixteen: that far a lens of a narrow field is from what it is stated to be.
    assert begun.intrinsics["left"].fx == pytest.approx(8000.0, rel=0.06)


@pytest.mark.parametrize("seed", [109, 110])
def test_a_view_that_loses_its_pose_with_another_lens_is_left_out(seed: int) -> None:
    true = shots(seed, images=12, noise=0.4)
    k = true.corners.point
    few = (k % COLUMNS < 3) & (k // COLUMNS < 3)
    few &= np.random.default_rng(seed).random(len(k)) < 0.75
    begun = start(true.corners.where(few), None, None, true.sizes, free=EVERY)
    assert 8 <= len(begun.corners.views) < 12
    assert begun.rms < 1.0
