"""Boards rendered at known places are detected there, and hostile images stop nothing."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loopcal.files.cameras import detectors
from loopcal.files.cameras import images as module
from loopcal.files.cameras.detectors import _refined, corner_sds, tag_corners
from loopcal.files.cameras.images import detect
from loopcal.mechanisms.cameras import printed
from loopcal.mechanisms.cameras.board import Board
from tests.files.cameras import rendered
from tests.refusals import refused

cv2: Any = pytest.importorskip("cv2", reason="OpenCV is not installed (loopcal[images])")

BOARDS = {
    "checkerboard": (rendered.checkerboard(9, 6), printed.checkerboard(9, 6, 0.03)),
    "charuco": (
        rendered.charuco(cv2, (5, 7), 0.7, legacy=False),
        printed.charuco((5, 7), 0.03, 0.021, "5X5_100"),
    ),
    "legacy charuco": (
        rendered.charuco(cv2, (5, 8), 0.7, legacy=True),
        printed.charuco((5, 8), 0.03, 0.021, "5X5_100", legacy=True),
    ),
    "aprilgrid": (rendered.aprilgrid(cv2, 4, 3), printed.aprilgrid(4, 3, 0.08, 0.3)),
    "tags alone": (
        rendered.aprilgrid(cv2, 4, 3, squares=False),
        printed.aprilgrid(4, 3, 0.08, 0.3),
    ),
    "circles": (
        rendered.circles(cv2, 7, 6, asymmetric=False),
        printed.circles(7, 6, 0.02),
    ),
    "asymmetric circles": (
        rendered.circles(cv2, 4, 9, asymmetric=True),
        printed.circles(4, 9, 0.02, asymmetric=True),
    ),
}


def write(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("kind", BOARDS)
def test_corners_of_a_rendered_board_are_where_they_are(kind: str, tmp_path: Path) -> None:
    print_, board = BOARDS[kind]
    image, truth = rendered.seen(cv2, print_)
    corners = detect(write(tmp_path / "1.png", image), board).corners
    assert set(corners.point) == set(truth)
    errors = np.array([corners.u, corners.v]).T - [truth[point] for point in corners.point]
    assert np.abs(errors).max() < 0.1
    assert (corners.sd is None) == ("circles" in kind)
    assert corners.sizes == (("1", (640, 480)),)


@pytest.mark.parametrize("kind", ["checkerboard", "circles"])
def test_a_pattern_is_sought_in_a_smaller_image_and_refined_in_the_whole_one(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    print_, board = BOARDS[kind]
    image, truth = rendered.seen(cv2, print_)
    assert board.pattern is not None
    monkeypatch.setattr(detectors, "_FINE", 100_000)
    path = write(tmp_path / "1.png", image)
    seen = json.loads(detectors.packed(str(path), asdict(board.pattern)))
    errors = [np.subtract((u, v), truth[point]) for point, u, v, _ in seen["points"]]
    assert len(errors) == len(truth)
    assert np.abs(errors).max() < 0.1


def test_a_board_upside_down_keeps_the_names_of_its_corners(tmp_path: Path) -> None:
    print_, board = BOARDS["checkerboard"]
    outline = ((520, 420), (100, 380), (80, 60), (560, 100))
    image, truth = rendered.seen(cv2, print_, outline)
    corners = detect(write(tmp_path / "1.png", image), board).corners
    errors = np.array([corners.u, corners.v]).T - [truth[point] for point in corners.point]
    assert np.abs(errors).max() < 0.1


def test_the_stated_sd_is_the_scatter_over_noise() -> None:
    drawn = [rendered.seen(cv2, rendered.checkerboard(9, 6), noise=4.0, seed=s) for s in range(8)]
    truth = np.array(list(drawn[0][1].values()))
    refined = np.array([_refined(cv2, image, truth, 0.25).reshape(-1, 2) for image, _ in drawn])
    scatter = np.sqrt(np.mean(refined.var(axis=0, ddof=1)))
    stated = np.sqrt(np.mean(corner_sds(drawn[0][0], truth) ** 2))
    # 8 draws of 108 coordinates: the scatter is known to 3 %.
    assert 0.9 < stated / scatter < 1.1


def test_corners_of_tags_alone_are_where_they_are_on_average_and_scatter_as_stated() -> None:
    print_ = rendered.aprilgrid(cv2, 4, 3, squares=False)
    drawn = [rendered.seen(cv2, print_, noise=4.0, seed=s) for s in range(8)]
    truth = np.array(list(drawn[0][1].values())).reshape(12, 4, 2)
    made = np.array([[tag_corners(cv2, image, one) for one in truth] for image, _ in drawn])
    away = truth - truth.mean(axis=1, keepdims=True)
    outwards = ((made[..., :2].mean(axis=0) - truth) * away).sum(axis=2)
    # Windows around the corners are 0.16 px off here.
    assert abs(np.mean(outwards / np.linalg.norm(away, axis=2))) < 0.02
    scatter = np.sqrt(np.mean(made[..., :2].var(axis=0, ddof=1)))
    assert 0.9 < np.sqrt(np.mean(made[..., 2] ** 2)) / scatter < 1.1


def test_images_are_named_by_view_and_camera_and_faults_by_image(tmp_path: Path) -> None:
    print_, board = BOARDS["checkerboard"]
    image, _ = rendered.seen(cv2, print_)
    for name in ("left/03.png", "right/03.png"):
        write(tmp_path / name, image)
    write(tmp_path / "left/04.png", np.full_like(image, 128))
    write(tmp_path / "left/05.png", image[:, :600])
    (tmp_path / "left/06.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"x" * 500)
    (tmp_path / "left/notes.txt").write_text("no image", "utf-8")
    done = detect(tmp_path, board)
    assert done.corners.images == ("03",)
    assert done.corners.cameras == ("left", "right")
    assert list(done.missed) == ["left/04.png", "left/05.png", "left/06.png"]
    assert "600 x 480" in done.missed["left/05.png"]
    two = detect([tmp_path / "right/03.png", tmp_path / "left/03.png"], board).corners
    assert (two.images, two.cameras) == (("03",), ("right", "left"))


def test_a_bomb_is_named_and_the_other_images_are_read(tmp_path: Path) -> None:
    print_, board = BOARDS["checkerboard"]
    write(tmp_path / "good.png", rendered.seen(cv2, print_)[0])

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", 32_000, 32_000, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(1 << 20), 9)
    (tmp_path / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )
    done = detect(tmp_path, board)
    assert done.corners.images == ("good",)
    assert list(done.missed) == ["bomb.png"]


def test_a_board_printed_the_old_way_is_named(tmp_path: Path) -> None:
    print_, _ = BOARDS["legacy charuco"]
    path = write(tmp_path / "1.png", rendered.seen(cv2, print_)[0])
    with refused("no-data", "legacy = true"):
        detect(path, printed.charuco((5, 8), 0.03, 0.021, "5X5_100"))


def test_what_cannot_be_looked_for_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refused("missing-key", "'wall'"):
        detect(tmp_path, Board("wall", {"0": (0.0, 0.0, 0.0)}))
    with refused("no-data", "image"):
        detect(tmp_path, printed.checkerboard(9, 6, 0.03))
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with refused("missing-dependency", "loopcal[images]"):
        detect(tmp_path, printed.checkerboard(9, 6, 0.03))
