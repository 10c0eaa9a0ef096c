"""The corners of a board in one image, by OpenCV; runs in the guarded child alone.

The sd of a corner is what the noise of the grey values explains. The point c that minimises
sum (g_i . (x_i - c))^2 over a window, with g_i the gradient at pixel x_i (Förstner and Gülch 1987),
moves by M^-1 sum g_i (dg_i . (x_i - c)) with M = sum g_i g_i^T where noise changes the gradients by
dg_i. The noise itself is estimated as by Immerkær (1996).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError

Points = dict[str, tuple[float, ...]]
"""By id u and v [px], and the sd [px] where the finder knows it."""
_MOST_PIXELS = 200_000_000
"""Of an image; the largest sensors of industrial cameras have 150 million."""
_APRIL = (1, 0, 3, 2)
"""Kalibr's corners 0 to 3 in what OpenCV finds, whose AprilTags are turned by 180 degrees."""
_ARUCO = (3, 2, 1, 0)
_TAG_SHARE = 0.12
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
    uv = np.array([one[:2] for one in points.values()]).reshape(-1, 2)
    # Centres of circles are no corners.
    corners = "circles" not in pattern["kind"]
    sds = corner_sds(grey, uv) if corners else np.full(len(uv), np.nan)
    every = zip(points.items(), sds.tolist(), strict=True)
    rows = [[name, *([*one, sd] if len(one) == 2 else one)] for (name, one), sd in every]
    height, width = grey.shape
    return json.dumps({"size": [width, height], "points": rows}).encode()


_CLASSIC = 1 | 2 | 8
"""CALIB_CB_ADAPTIVE_THRESH, NORMALIZE_IMAGE and FAST_CHECK."""


def _checkerboard(cv2: Any, grey: Any, pattern: dict[str, Any]) -> Points:
    size = (pattern["columns"], pattern["rows"])
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    for factor, small in _reduced(cv2, grey):
        seen, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
        if not seen:
            seen, corners = cv2.findChessboardCorners(small, size, flags=_CLASSIC)
        if seen:
            rough = _enlarged(_refined(cv2, small, corners, 0.25), factor)
            break
    else:
        return {}
    # On rendered boards of known corners the refined ones scatter by a tenth of those of SB.
    uv = _refined(cv2, grey, rough, 0.25).reshape(pattern["rows"], pattern["columns"], 2)
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
    for factor, small in _reduced(cv2, grey):
        for more in (0, cv2.CALIB_CB_CLUSTERING):
            seen, centres = cv2.findCirclesGrid(small, size, flags=flag | more)
            if seen:
                rough = _enlarged(centres, factor)
                return _in_order(rough if factor == 1 else _centred(grey, rough))
    return {}


def _centred(grey: Any, rough: Array) -> Array:
    """(n, 2) centres of the dark within windows that hold one circle each, about rough ones."""
    apart = np.linalg.norm(rough[:, None] - rough, axis=2)
    least = int(0.45 * apart[apart > 0.0].min())
    reach = np.arange(-least, least + 1)
    window = np.stack(np.meshgrid(reach, reach), axis=-1)
    centres = []
    for one in rough:
        values = _grey_at(grey, one + window)
        dark = np.clip(0.5 * (values.max() + values.min()) - values, 0.0, None)
        centres.append(one + np.einsum("ij,ijk->k", dark, window) / dark.sum())
    return np.array(centres)


def _reduced(cv2: Any, grey: Any) -> Iterator[tuple[int, Any]]:
    """The image reduced 2, 4, ... times, the smallest first, whose pixels are at most 8 million.

    A finder of patterns takes many times the memory of an image, and needs no fine one.
    """
    factor = 1
    while grey.size > _FINE * factor**2:
        factor *= 2
    while factor and grey.size <= 4 * _FINE * factor**2:
        height, width = (side // factor for side in grey.shape)
        part = grey[: height * factor, : width * factor]
        small = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
        yield factor, grey if factor == 1 else small
        factor //= 2


_FINE = 2_000_000
"""Pixels among which any board fit for calibration shows; four times as many are tried as well."""


def _enlarged(points: Any, factor: int) -> Array:
    """(n, 2) pixels of an image in the one that it was reduced from."""
    return factor * np.reshape(points, (-1, 2)).astype(float) + 0.5 * (factor - 1)


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
        raise InputError(
            f"the board is seen with legacy = {str(legacy).lower()} alone", code="conflicting-keys"
        )
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
                uv = tag_corners(cv2, grey, np.reshape(tag, (4, 2)).astype(float))
                for k, i in enumerate(order):
                    u, v, sd = uv[i].tolist()
                    points[f"{number}.{k}"] = (u, v) if math.isnan(sd) else (u, v, sd)
        best = points if len(points) > len(best) else best
    return best


_FINDERS: dict[str, Callable[[Any, Any, dict[str, Any]], Points]] = {
    "checkerboard": _checkerboard,
    "charuco": _charuco,
    "aprilgrid": _aprilgrid,
    "circles": _circles,
    "asymmetric circles": _circles,
}


# Where two black squares touch, blur leaves a corner in its place. Where a tag's corner stands
# alone in white, blur rounds it off: then the corner is where the edges meet.


def tag_corners(cv2: Any, grey: Any, rough: Array) -> Array:
    """(4, 3) u, v and sd [px] of the corners of a tag; sd is NaN of those that touch a square."""
    corners = _refined(cv2, grey, rough, _TAG_SHARE).reshape(4, 2).astype(float)
    away = corners - corners.mean(axis=0)
    middles = 0.5 * (away + np.roll(away, -1, axis=0))
    beyond, within = (_grey_at(grey, corners + share * away) for share in (0.1, -0.08))
    white = _grey_at(grey, corners - away + 1.15 * middles)
    alone = beyond > 0.5 * (within + 0.5 * (white + np.roll(white, 1)))
    sharp: Array = np.hstack([corners, np.full((4, 1), np.nan)])
    for i in np.flatnonzero(alone):
        ends = (corners[i - 1], corners[(i + 1) % 4])
        edges = np.array([_edge(grey, corners[i], end, away[i]) for end in ends])
        N, d, variances = edges[:, :2], edges[:, 2], edges[:, 3]
        if np.isfinite(edges).all() and np.linalg.cond(N) < _SQUARE:
            inverse = np.linalg.inv(N)
            sharp[i, :2] = inverse @ d
            sharp[i, 2] = math.sqrt(0.5 * np.trace(inverse @ np.diag(variances) @ inverse.T))
    return sharp


_FAINT = 10.0
"""Grey values across an edge, of 255, below which its place is that of noise."""
_SQUARE = 20.0
"""Condition of the normals of two edges, beyond which they hardly meet; 1 where they are square."""


def _edge(grey: Any, corner: Array, other: Array, away: Array) -> Array:
    """n (2,), d, Var d of the line n . x = d along a tag's edge near a corner.

    NaN where the edge is short or faint.
    At each pixel along the edge it lies at the mean of the steps of grey across it. The scatter
    about the line gives its variance, at the corner.
    """
    length = float(np.linalg.norm(other - corner))
    along = (other - corner) / length
    across = np.array([-along[1], along[0]])
    across *= np.sign(across @ away)
    half = float(np.clip(0.08 * length, 2.0, 5.0))
    # Beyond what blur rounds off, and so near that no lens bends the edge.
    t = np.arange(max(half, 0.1 * length), 0.45 * length)
    s = np.arange(-half, half + 0.25, 0.5)
    if len(t) < 5:
        return np.full(4, np.nan)
    points = corner + t[:, None, None] * along + s[:, None] * across
    steps = np.diff(_grey_at(grey, points))
    if steps.sum(axis=1).min() < _FAINT:
        return np.full(4, np.nan)
    at = steps @ (0.5 * (s[1:] + s[:-1])) / steps.sum(axis=1)
    slope, offset = np.polyfit(t, at, 1)
    # A value between pixels, the share a of one and 1 - a of the other, scatters by
    # E(a^2 + (1 - a)^2) = 2/3 of what it adds to sums along the edge.
    scatter = 1.5 * np.square(at - offset - slope * t).sum() / (len(t) - 2)
    variance = scatter * (1.0 / len(t) + t.mean() ** 2 / np.square(t - t.mean()).sum())
    n = across - slope * along
    return np.array([*n, n @ (corner + offset * across), variance])


def _grey_at(grey: Any, points: Array) -> Array:
    """(...) grey values at points (..., 2), linear between pixels."""
    height, width = grey.shape
    u = np.clip(points[..., 0], 0.0, width - 1.001)
    v = np.clip(points[..., 1], 0.0, height - 1.001)
    i, j = u.astype(int), v.astype(int)
    a, b = u - i, v - j
    above = (1.0 - a) * grey[j, i] + a * grey[j, i + 1]
    below = (1.0 - a) * grey[j + 1, i] + a * grey[j + 1, i + 1]
    return np.asarray((1.0 - b) * above + b * below, dtype=float)


def _dictionary(cv2: Any, pattern: dict[str, Any]) -> Any:
    number = getattr(cv2.aruco, f"DICT_{pattern['dictionary']}", None)
    if number is None:
        raise InputError(f"OpenCV has no dictionary {pattern['dictionary']!r}", code="unknown-name")
    return cv2.aruco.getPredefinedDictionary(number)


def _in_order(corners: Any) -> Points:
    uv = np.reshape(corners, (-1, 2)).astype(float).tolist()
    return {str(i): (u, v) for i, (u, v) in enumerate(uv)}


def _refined(cv2: Any, grey: Any, corners: Any, share: float) -> Any:
    """Corners to fractions of a pixel; share: half the window over the distance of corners.

    Windows shrink: that of the first round reaches as far as a rough corner may be off.
    """
    corners = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    half = _half_window(corners[:, 0], share, most=50)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    while True:
        corners = cv2.cornerSubPix(grey, corners, (half, half), (-1, -1), stop)
        if half <= _WINDOW:
            return corners
        half = max(half // 2, _WINDOW)


_WINDOW = 7
"""Half the last window [px]: twice the blur of any sharp image, and few pixels of its noise."""


def _half_window(uv: Any, share: float = 0.25, most: int = _WINDOW) -> int:
    """A share of the least distance between successive corners [px], at least 2."""
    apart = np.linalg.norm(np.diff(uv, axis=0), axis=1)
    apart = apart[apart > 0.0]
    return int(np.clip(share * apart.min(), 2, most)) if apart.size else 2


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
