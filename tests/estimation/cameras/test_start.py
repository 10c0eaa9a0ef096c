"""A start from nothing arrives at the truth, whatever is held by the hand."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.estimation.cameras.start import start
from tests.estimation.cameras.truth import shots


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


def test_three_corners_are_refused() -> None:
    true = shots(17)
    few = true.corners.where(true.corners.point < 3)
    with pytest.raises(InputError, match="four corners"):
        start(few, true.T, true.intrinsics, true.sizes, True)


def test_images_without_a_pose_are_left_out() -> None:
    true = shots(19)
    T = true.T.copy()
    T[4] = np.nan
    begun = true.start(T=T)
    assert 4 not in begun.corners.image
    np.testing.assert_allclose(begun.X[0], true.X, atol=4e-3)
