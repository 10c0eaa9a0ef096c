"""The corners of a board in one image, by OpenCV; runs in the guarded child alone.

The sd of a corner is what the noise of the grey values explains. The point c that minimises
sum (g_i . (x_i - c))^2 over a window, with g_i the gradient at pixel x_i (Förstner and Gülch 1987),
moves by M^-1 sum g_i (dg_i . (x_i - c)) with M = sum g_i g_i^T where noise changes the gradients by
dg_i. The noise itself is estimated as by Immerkær (1996).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError

Array = NDArray[np.float64]
Points = dict[str, tuple[float, float]]
_MOST_PIXELS = 200_000_000
"""Of an image; the largest sensors of industrial cameras have 150 million."""
_APRIL = (1, 0, 3, 2)
"""Kalibr's corners 0 to 3 in what OpenCV finds, whose AprilTags are turned by 180 degrees."""
_ARUCO = (3, 2, 1, 0)
_TAG_SHARE = 0.15
"""Of a tag's side: its black border is at least an eighth of it, the gap about 0.3."""


def packed(path: str, pattern: dict[str, Any]) -> bytes:
    """Size [px] of the image, and id, u, v, sd [px] of each corner, as JSON.

    Raises InputError for what is no image.
    """
    import cv2

    cv2.setNumThreads(1)
    data = np.fromfile(path, dtype=np.uint8)
    grey = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if grey is None or grey.size > _MOST_PIXELS:
        raise InputError("it is no image that OpenCV reads", code="wrong-file-type")
    points = _FINDERS[pattern["kind"]](cv2, grey, pattern)
    uv = np.array(list(points.values())).reshape(-1, 2)
    # Centres of circles are no corners.
    corners = "circles" not in pattern["kind"]
    sds = corner_sds(grey, uv) if corners else np.full(len(uv), np.nan)
    rows = [[name, *uv, sd] for (name, uv), sd in zip(points.items(), sds.tolist(), strict=True)]
    height, width = grey.shape
    return json.dumps({"size": [width, height], "points": rows}).encode()


_CLASSIC = 1 | 2 | 8
"""CALIB_CB_ADAPTIVE_THRESH, NORMALIZE_IMAGE and FAST_CHECK."""


def _checkerboard(cv2: Any, grey: Any, pattern: dict[str, Any]) -> Points:
    size = (pattern["columns"], pattern["rows"])
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    seen, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not seen:
        seen, corners = cv2.findChessboardCorners(grey, size, flags=_CLASSIC)
    if not seen:
        return {}
    # On rendered boards of known corners the refined ones scatter by a tenth of those of SB.
    uv = _refined(cv2, grey, corners, 0.25).reshape(pattern["rows"], pattern["columns"], 2)
    # Where columns and rows differ in parity, a half turn exchanges black and white: the first
    # square inside is black, as printed boards have it.
    turned = (pattern["columns"] + pattern["rows"]) % 2 and _shade(grey, uv) > 0.0
    return _in_order(uv[::-1, ::-1] if turned else uv)


def _shade(grey: Any, uv: Any) -> float:
    """How much lighter the first square is than the next ones of its row."""
    inner = (uv[:-1, :-1] + uv[1:, :-1] + uv[:-1, 1:] + uv[1:, 1:]) / 4.0
    u, v = np.rint(inner).astype(int).transpose(2, 0, 1)
    signs = (-1.0) ** np.add.outer(np.arange(u.shape[0]), np.arange(u.shape[1]))
    return float(np.sum(signs * grey[v, u]))


def _circles(cv2: Any, grey: Any, pattern: dict[str, Any]) -> Points:
    size = (pattern["columns"], pattern["rows"])
    asymmetric = pattern["kind"].startswith("asymmetric")
    flag = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for more in (0, cv2.CALIB_CB_CLUSTERING):
        seen, centres = cv2.findCirclesGrid(grey, size, flags=flag | more)
        if seen:
            return _in_order(centres)
    return {}


def _charuco(cv2: Any, grey: Any, pattern: dict[str, Any]) -> Points:
    size = (pattern["columns"], pattern["rows"])
    board = cv2.aruco.CharucoBoard(size, 1.0, pattern["marker"], _dictionary(cv2, pattern))
    for legacy in (pattern["legacy"], not pattern["legacy"]):
        board.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is not None:
            break
    else:
        return {}
    if legacy != pattern["legacy"]:
        raise InputError(f"the board is seen with legacy = {str(legacy).lower()} alone")
    # No marker reaches into the window: it ends half the rest of a square away from the corner.
    uv = _refined(cv2, grey, corners, 0.45 * (1.0 - pattern["marker"])).reshape(-1, 2).astype(float)
    return {str(i): (u, v) for i, (u, v) in zip(np.ravel(ids).tolist(), uv.tolist(), strict=True)}


def _aprilgrid(cv2: Any, grey: Any, pattern: dict[str, Any]) -> Points:
    dictionary = _dictionary(cv2, pattern)
    order = _APRIL if pattern["dictionary"].upper().startswith("APRIL") else _ARUCO
    most = pattern["columns"] * pattern["rows"]
    best: Points = {}
    for border in (2, 1):  # of black bits around the code; Kalibr prints two
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = border
        tags, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
        points: Points = {}
        for tag, number in zip(tags, () if ids is None else np.ravel(ids).tolist(), strict=True):
            if number < most:
                uv = _refined(cv2, grey, tag, _TAG_SHARE)
                for k, i in enumerate(order):
                    points[f"{number}.{k}"] = tuple(np.reshape(uv[i], 2).astype(float).tolist())
        best = points if len(points) > len(best) else best
    return best


_FINDERS: dict[str, Callable[[Any, Any, dict[str, Any]], Points]] = {
    "checkerboard": _checkerboard,
    "charuco": _charuco,
    "aprilgrid": _aprilgrid,
    "circles": _circles,
    "asymmetric circles": _circles,
}


def _dictionary(cv2: Any, pattern: dict[str, Any]) -> Any:
    number = getattr(cv2.aruco, f"DICT_{pattern['dictionary']}", None)
    if number is None:
        raise InputError(f"OpenCV has no dictionary {pattern['dictionary']!r}")
    return cv2.aruco.getPredefinedDictionary(number)


def _in_order(corners: Any) -> Points:
    uv = np.reshape(corners, (-1, 2)).astype(float).tolist()
    return {str(i): (u, v) for i, (u, v) in enumerate(uv)}


def _refined(cv2: Any, grey: Any, corners: Any, share: float) -> Any:
    """Corners to fractions of a pixel; share: half the window over the distance of corners."""
    corners = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    half = _half_window(corners[:, 0], share)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    return cv2.cornerSubPix(grey, corners, (half, half), (-1, -1), stop)


def _half_window(uv: Any, share: float = 0.25) -> int:
    """A share of the least distance between successive corners [px], from 2 to 7."""
    apart = np.linalg.norm(np.diff(uv, axis=0), axis=1)
    apart = apart[apart > 0.0]
    return int(np.clip(share * apart.min(), 2, 7)) if apart.size else 2


def corner_sds(grey: Any, uv: Array) -> Array:
    """(n,) sd [px] of each corner per axis that the noise of an image explains; NaN at its rim."""
    half = _half_window(uv)
    grey = np.asarray(grey, dtype=np.int16)
    noise = _noise(grey)
    return np.array([noise * _gain(grey, u, v, half) for u, v in uv])


def _noise(grey: Any) -> float:
    """The sd of the grey values of neighbours, from the median of what no smooth image holds."""
    rows = grey[:-2] - 2 * grey[1:-1] + grey[2:]
    rough = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
    # Normal noise of sd 1 has sd 6 in these differences, half of them below 0.6745 of it; grey
    # values are rounded besides, whose sd is 1 / sqrt(12).
    return max(float(np.median(rough)) / (6.0 * 0.6745), math.sqrt(1.0 / 12.0))


def _gain(grey: Any, u: float, v: float, half: int) -> float:
    """sd of a corner per sd of the grey values."""
    column, row = round(u), round(v)
    height, width = grey.shape
    reach = half + 1
    if not (reach <= column < width - reach and reach <= row < height - reach):
        return float("nan")
    part = grey[row - reach : row + reach + 1, column - reach : column + reach + 1].astype(float)
    g = np.array([part[1:-1, 2:] - part[1:-1, :-2], part[2:, 1:-1] - part[:-2, 1:-1]]) / 2.0
    steps = np.arange(-half, half + 1)
    d = np.array(np.meshgrid(steps + column - u, steps + row - v))
    M = np.einsum("aij,bij->ab", g, g)
    if not np.linalg.cond(M) < 1e6:
        return float("nan")
    # A grey value at p enters the gradients of its neighbours: its share in x is -div (a d^T),
    # a = M^-1 g.
    A = np.einsum("ab,bij,cij->acij", np.linalg.inv(M), g, d)
    A = np.pad(A, ((0, 0), (0, 0), (2, 2), (2, 2)))
    across = A[:, 0, 1:-1, :-2] - A[:, 0, 1:-1, 2:]
    along = A[:, 1, :-2, 1:-1] - A[:, 1, 2:, 1:-1]
    return float(np.sqrt(np.mean(np.sum(((across + along) / 2.0) ** 2, axis=(1, 2)))))
