"""Corners in YAML, JSON and OpenCV's XML: detections of tags, and lists of pixels by image.

tags    tag_id and corners of each tag, in lists by image
lists   `corners`, `image_points`, ...: pairs u, v in the order of the board, or beside `ids`
matrix  `image_points` of OpenCV: a row for each image, two channels
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from loopcal.files.cameras.document import Part

TAGS = ("tag_id", "id", "marker_id")
"""How the number of a tag is named."""
LISTS = (
    *("corners", "image_points", "img_points", "charuco_corners", "detected_corners", "keypoints"),
    *("points_2d", "points2d", "pixels", "corners_px"),
)
"""How the pixels of an image are named."""
_IDS = ("ids", "charuco_ids", "corner_ids", "point_ids", "points_ids")
_IMAGE = (
    *("image", "file", "filename", "frame", "image_id", "name", "timestamp"),
    *("image_name", "file_path", "image_path", "image_file", "img"),
)
_SEVERAL = ("detections", "tags", "markers", "images", "frames", "apriltags")
_NAMES = ("id", "point", "corner", "index", "charuco_id", "corner_id", "point_id")
_OF_TAG = 4
_Pixel = tuple[str, float, float]
"""Point, "" where it has no name, u and v."""
_Corner = tuple[str, str, float, float]
"""Image, point, u and v; NaN of a corner that was not seen."""


def corners_in(document: Part) -> list[_Corner]:
    """The corners of all images in a document, an empty list where none are recognised."""
    return list(_corners(document, "1", 4))


def has_tags(points: Sequence[str]) -> bool:
    """Whether points are corners of tags, TAG.CORNER."""
    return any("." in point for point in points)


def _corners(part: Part, image: str, depth: int) -> Iterator[_Corner]:
    stated = part.get(*_IMAGE)
    image = stated.text if stated is not None and _is_scalar(stated.data) else image
    tag, corners = part.get(*TAGS), part.get("corners", "p", "points")
    if tag is not None and corners is not None and len(_items(corners)) == _OF_TAG:
        for k, corner in enumerate(corners.parts()):
            u, v = corner.numbers(2)
            yield image, f"{tag.text}.{k}", u, v
        return
    pixels = part.get(*LISTS)
    views = _views(pixels) if pixels is not None else []
    for i, view in enumerate(views):
        ids = part.get(*_IDS) if len(views) == 1 else None
        names = [name or str(k) for k, (name, _, _) in enumerate(view)]
        names = names if ids is None else [f"{n:g}" for n in ids.numbers(len(view))]
        of = image if len(views) == 1 else str(i)
        yield from ((of, name, u, v) for name, (_, u, v) in zip(names, view, strict=True))
    if views or not depth:
        return
    if isinstance(part.data, list):
        for i, one in enumerate(part.parts()):
            inner = image if "tag_id" in one or "id" in one or stated else str(i)
            yield from _corners(one, inner, depth - 1)
        return
    for name, one in part.items():
        if not _is_scalar(one.data):
            yield from _corners(one, image if name in _SEVERAL else name, depth - 1)


def _is_scalar(data: Any) -> bool:
    return not isinstance(data, dict | list)


def _items(part: Part) -> list[Any]:
    return part.data if isinstance(part.data, list) else []


def _views(part: Part) -> list[list[_Pixel]]:
    """The pixels of each image that a value holds, an empty list where it holds no pixels."""
    if "data" in part:
        return _of_matrix(part)
    inside = part.parts() if isinstance(part.data, list) else []
    if not inside:
        return []
    pairs = [_pixel(one) for one in inside]
    if all(pair is not None for pair in pairs):
        return [[pair for pair in pairs if pair is not None]]
    several = [_views(one) for one in inside]
    return [one[0] for one in several] if all(len(one) == 1 for one in several) else []


def _of_matrix(part: Part) -> list[list[_Pixel]]:
    """Of a matrix of OpenCV: two channels, a row for each image, or the points one below the other;
    or one channel in two columns."""
    rows, columns, kind = (part.get(name) for name in ("rows", "cols", "dt"))
    if rows is None or columns is None or kind is None:
        return []
    shape = (rows.count, columns.count)
    channels = 2 if kind.text.strip('"').startswith("2") else 1
    if channels * shape[1] < 2 or (channels == 1 and shape[1] != 2):
        return []
    numbers = [_number(value) for value in _items(part.part("data"))]
    if len(numbers) != channels * shape[0] * shape[1]:
        raise part.wrong(f"a matrix of {channels * shape[0] * shape[1]} numbers")
    pixels = [("", u, v) for u, v in zip(numbers[::2], numbers[1::2], strict=True)]
    of_one = shape[1] if channels == 2 and shape[1] > 1 else shape[0]
    return [pixels[i : i + of_one] for i in range(0, len(pixels), of_one)]


def _pixel(part: Part) -> _Pixel | None:
    """A pair u, v, also alone in a list, or a mapping with u and v, or x and y, and the number of
    the point; None for anything else."""
    if isinstance(part.data, dict):
        u, v, name = part.get("u", "x", "px"), part.get("v", "y", "py"), part.get(*_NAMES)
        if u is None or v is None or "z" in part:
            return None
        return name.text if name else "", _number(u.data), _number(v.data)
    items = _items(part)
    if len(items) == 1 and isinstance(items[0], list):
        items = items[0]
    if len(items) != 2 or not all(_is_scalar(item) for item in items):
        return None
    return "", _number(items[0]), _number(items[1])


def _number(value: Any) -> float:
    """A number, NaN where there is none."""
    try:
        return math.nan if value is None else float(value)
    except (TypeError, ValueError):
        return math.nan
