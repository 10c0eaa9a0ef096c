"""A camera beside the robot that sees a board beside it, among the files of other cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import loopcal as lc
from tests.mechanisms.test_camera import POINTS, hands, pixels
from tests.workflow.beginning.test_from_images import written

IMAGES = 14


def _folder(folder: Path, seed: int = 5) -> Path:
    """Images of a hand's camera, and of one that stands before the same board."""
    T = hands(IMAGES, seed)
    folder.mkdir()
    noise = np.random.default_rng(6).normal(0.0, 0.2, (2, len(POINTS), 2, IMAGES))
    written(folder, pixels(T, on="body") + noise[0], T)
    still = pixels(T[:1], on="base") + noise[1]
    rows = (folder / "corners.csv").read_text("utf-8").splitlines()
    for point, (u, v) in zip(POINTS, still, strict=True):
        rows += [f"{i},2,board,{point},{u[i]:.5f},{v[i]:.5f}" for i in range(IMAGES)]
    (folder / "corners.csv").write_text("\n".join(rows) + "\n", "utf-8")
    return folder


def test_what_stands_still_is_left_out_and_the_rest_is_calibrated(tmp_path: Path) -> None:
    project = lc.init(_folder(tmp_path / "day"), out=tmp_path / "calibration")
    words = str(project)
    assert "the camera '2' sees the board 'board' at one place in all images" in words
    assert f"its {len(POINTS) * IMAGES} corners are left out" in words
    assert "T_base_camera = T_base_board T_camera_board^-1" in words
    assert {name.split(":")[0] for name in project.dataset.readings if ":" in name} == {"camera_1"}


def test_a_camera_whose_board_moves_stays(tmp_path: Path) -> None:
    T = hands(IMAGES, 5)
    written(tmp_path, pixels(T, on="body"), T)
    assert "at one place in all images" not in str(lc.init(tmp_path))
