"""Images of printed boards at known corners: prints seen through a homography, with blur, noise."""

from __future__ import annotations

from typing import Any

import numpy as np

Print = tuple[np.ndarray, dict[str, tuple[float, float]]]
"""Grey values, and id -> pixel of each corner, (0, 0) the centre of the first pixel."""
SQUARE, RIM = 40, 60
"""Pixels of a printed square, and of the white around the board."""


def checkerboard(columns: int, rows: int) -> Print:
    """The inner corners; the square at the first corner is black."""
    cells = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    grey = np.kron(255 * cells, np.ones((SQUARE, SQUARE))).astype(np.uint8)
    ids = [(i, j) for j in range(rows) for i in range(columns)]
    points = {
        str(n): (RIM + (i + 1) * SQUARE - 0.5, RIM + (j + 1) * SQUARE - 0.5)
        for n, (i, j) in enumerate(ids)
    }
    return np.pad(grey, RIM, constant_values=255), points


def charuco(cv2: Any, squares: tuple[int, int], ratio: float, *, legacy: bool) -> Print:
    """A board of 5x5 markers as OpenCV prints it."""
    columns, rows = squares
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard(squares, 1.0, ratio, dictionary)
    board.setLegacyPattern(legacy)
    grey = board.generateImage((columns * SQUARE * 2, rows * SQUARE * 2))
    ids = [(i, j) for j in range(1, rows) for i in range(1, columns)]
    points = {
        str(n): (RIM + i * 2 * SQUARE - 0.5, RIM + j * 2 * SQUARE - 0.5)
        for n, (i, j) in enumerate(ids)
    }
    return np.pad(grey, RIM, constant_values=255), points


def aprilgrid(
    cv2: Any, columns: int, rows: int, *, squares: bool = True, side: int = 80, gap: int = 24
) -> Print:
    """A grid as Kalibr prints it: two black bits around each code, black squares between tags."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    step = side + gap
    height, width = rows * step + gap + 2 * RIM, columns * step + gap + 2 * RIM
    grey, points = np.full((height, width), 255, np.uint8), {}
    for number, (row, column) in enumerate(np.ndindex(rows, columns)):
        # OpenCV's tags stand on their heads.
        tag = np.rot90(cv2.aruco.generateImageMarker(dictionary, number, 10, borderBits=2), 2)
        left, bottom = RIM + gap + column * step, height - RIM - gap - row * step
        grey[bottom - side : bottom, left : left + side] = np.kron(tag, np.ones((side // 10,) * 2))
        for k, (x, y) in enumerate(((0, 0), (side, 0), (side, side), (0, side))):
            points[f"{number}.{k}"] = (left + x - 0.5, bottom - y - 0.5)
    for row, column in np.ndindex(rows + 1, columns + 1) if squares else ():
        left, bottom = RIM + column * step, height - RIM - row * step
        grey[bottom - gap : bottom, left : left + gap] = 0
    return grey, points


def circles(cv2: Any, columns: int, rows: int, *, asymmetric: bool) -> Print:
    """Black discs on white."""
    places = [
        ((2 * i + j % 2) if asymmetric else i, j) for j in range(rows) for i in range(columns)
    ]
    centres = [(RIM + SQUARE * x, RIM + SQUARE * y) for x, y in places]
    width, height = (max(c[k] for c in centres) + RIM for k in (0, 1))
    grey = np.full((height, width), 255, np.uint8)
    for centre in centres:
        cv2.circle(grey, centre, SQUARE // 3, 0, -1, lineType=cv2.LINE_AA)
    return grey, {str(n): (float(x), float(y)) for n, (x, y) in enumerate(centres)}


def seen(
    cv2: Any,
    printed: Print,
    corners: Any = ((80, 60), (560, 100), (520, 420), (100, 380)),
    *,
    noise: float = 2.0,
    seed: int = 0,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The image (480, 640) of a print whose outline has these corners, and where its points are."""
    grey, points = printed
    height, width = grey.shape
    outline = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(np.float32(outline), np.float32(corners))
    fine = 4  # samples per pixel and axis
    up = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1]])
    large = cv2.warpPerspective(grey, up @ H, (640 * fine, 480 * fine), borderValue=255)
    image = large.reshape(480, fine, 640, fine).mean(axis=(1, 3))
    image = 20.0 + 0.8 * cv2.GaussianBlur(image, (0, 0), 0.8)
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    at = np.array([[*point, 1.0] for point in points.values()]) @ H.T
    pixels = at[:, :2] / at[:, 2:]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), dict(zip(points, pixels, strict=True))
