"""A camera on the hand beside one that stands before a board on the same hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.parts import in_parts
from loopcal.estimation.cameras.start import CameraStart, start
from loopcal.mechanisms.placement import inverse
from tests.estimation.cameras.truth import Array, motion, pixel, shots

F = 2500.0


def both(seed: int) -> tuple[Corners, Array, Array, Array]:
    """Corners of both cameras, the hand (n, 4, 4), the second camera and its board."""
    eye = shots(seed, held=False, images=14)
    board = replace(eye.corners.boards[0], name="tool")
    Y = motion(np.array([0.3, -0.2, 0.1]), np.array([0.05, -0.03, 0.08]))
    X = motion(np.array([0.1, 0.2, -0.4]), np.zeros(3))
    X[:3, 3] = [0.0, 0.0, 1.5] - X[:3, :3] @ eye.T[:, :3, 3].mean(axis=0)
    random = np.random.default_rng(seed)
    uv, xyz = [], board.xyz
    for T in eye.T:
        P = X @ T @ Y
        seen = pixel(xyz @ P[:3, :3].T + P[:3, 3], F, np.array([800.0, 600.0]))
        uv.append(seen + random.normal(0.0, 0.2, seen.shape))
    n, one = len(xyz), eye.corners
    index = [
        np.concatenate([one.image, np.repeat(np.arange(len(eye.T)), n)]),
        np.repeat([0, 1], [len(one), n * len(eye.T)]),
        np.repeat([0, 1], [len(one), n * len(eye.T)]),
        np.concatenate([one.point, np.tile(np.arange(n), len(eye.T))]),
    ]
    corners = Corners.of(
        index,
        np.concatenate([one.uv, *uv]),
        ("cam", "fixed"),
        (*one.boards, board),
        one.poses,
    )
    return corners, eye.T, X, Y


@pytest.mark.parametrize("inverted", [False, True])
def test_each_part_has_its_own_mount_and_one_hand(inverted: bool) -> None:
    corners, T, X, Y = both(31)

    def run(some: Corners, hand: Array | None) -> CameraStart:
        return start(some, hand)

    begun = in_parts(corners, inverse(T) if inverted else T, run)
    assert begun.on_flange == {"cam"}
    assert begun.held is False
    assert begun.rms == pytest.approx(0.28, abs=0.03)
    assert begun.T_base_flange is not None
    np.testing.assert_allclose(begun.T_base_flange, T, atol=1e-9)
    np.testing.assert_allclose(begun.X[1], X, atol=0.02)
    np.testing.assert_allclose(begun.Y[1], Y, atol=0.02)
    np.testing.assert_array_equal(begun.corners.uv, corners.uv)
    np.testing.assert_allclose(
        begun.T_camera_board[corners.views.camera == 1], X @ T @ Y, atol=0.02
    )
    assert all(fact.sentence.startswith(("cam: ", "fixed: ")) for fact in begun.facts)
