"""The published sets are read whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from loopcal.files.cameras.boards import read_boards
from loopcal.files.cameras.corners import read_corners
from loopcal.files.cameras.intrinsics import read_rig
from loopcal.files.cameras.places import read_places


def test_a_charuco_board_on_a_flange(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("camera/ic_charuco")
    corners = read_corners(folder / "readings.csv")
    assert (len(corners), len(corners.images), corners.cameras) == (294, 16, ("1",))
    stated = read_boards(folder / "board.csv")["board"]
    described = read_boards(folder / "set.json")["board"]
    np.testing.assert_allclose(described.xyz, stated.xyz, atol=1e-7)
    assert described.pattern is not None
    assert described.pattern.legacy
    places = read_places(folder / "poses.csv")
    assert set(places.name) == set(corners.images)
    assert read_rig(folder / "set.json").cameras["1"].image == (1600, 1200)


def test_two_cameras_before_a_board(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("camera/stereo_chessboard")
    rig = read_rig(folder / "set.json")
    assert [one.lens for one in rig.cameras.values()] == ["brown5", "brown5"]
    assert np.isclose(rig.T_camera_first["right"][0, 3], 0.18973626)
    assert len(read_corners(folder / "readings.csv")) == 3080


def test_markers_on_two_hands(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("camera/motoman_right")
    assert {n: len(b.points) for n, b in read_boards(folder / "board.csv").items()} == {
        "left": 20,
        "right": 20,
    }
    assert read_rig(folder / "set.json").cameras["2"].distortion[4] == 0.662
