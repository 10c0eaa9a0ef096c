"""Corners as other programs write them: tables, long and wide, mrcal's corners.vnl, documents.

    long    a row per corner: image, camera, board, point (or tag and corner), u, v [px]
    wide    a row per image: u_0, v_0, u_1, v_1, ...; a blank cell is a corner not seen
    vnl     filename, x, y, level (mrcal): every corner of the board in its order, - if not seen
    JSON    and YAML: `corner_documents`

A table may state `centre of first pixel = 0.5` in a comment above its header.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.files.cameras.corner_documents import corners_in
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.document import DOCUMENTS, Part, read_document
from loopcal.files.recognition.headers import heading, own_words, words
from loopcal.files.tables.raw import bytes_of
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table

_FIRST_PIXEL = re.compile(rb"cent(?:re|er) of (?:the )?first pixel *[=:(] *(0\.5|0\.0|0)\b")
_HEAD = 4096
"""Bytes of a file in which the comments above its header stand."""
_PIXELS = re.compile(r"_(?:px|pix|pixels?)$")
_WIDE = (
    re.compile(r"(?P<axis>[uvxyz])_?(?P<point>\d+(?:_\d+)?)"),
    re.compile(r"(?:[a-z]+_?)?(?P<point>\d+(?:_\d+)?)_?(?P<axis>[uvxyz])"),
    re.compile(r"[a-z]+_(?P<axis>[uvxyz])_?(?P<point>\d+(?:_\d+)?)"),
)
_CAMERA = re.compile(
    r"(?:^|[-_. ])(?P<camera>cam(?:era)?[-_]?\d+|left|right)(?=$|[-_. ])", re.IGNORECASE
)
_CAMERA_FIRST = re.compile(r"(?P<camera>left|right|cam(?:era)?(?=[-_]))[-_]?(?=\d)", re.IGNORECASE)


def read_corners(path: str | Path) -> CornerTable:
    """The corners of a file; whatever its columns do not name is one camera "1", one "board".

    Rows whose u or v is missing are left out. Raises InputError, with row and column, for a table
    without columns of corners, and for what is no number; for one corner twice in an image, and for
    corners without names that are not equally many everywhere.
    """
    path = Path(path)
    if path.suffix.lower() in DOCUMENTS:
        return _made(*_in_document(read_document(path)), path.name)
    stated = _FIRST_PIXEL.search(bytes_of(path, _HEAD).lower()) if path.is_file() else None
    first_pixel = float(stated[1]) if stated else 0.0
    corners = corners_of(read_table(path), own_words(path.parent))
    return replace(corners, u=corners.u - first_pixel, v=corners.v - first_pixel)


def corners_of(table: Table, spoken: Mapping[str, str]) -> CornerTable:
    """The corners of a table; spoken: what further words of its header mean."""
    stems = [_stem(name, table, spoken) for name in table.names]
    wide = _wide_columns(stems)
    at = {meaning: _column(meaning, stems) for meaning in ("u", "v")}
    if None not in at.values():
        return _long(table, stems)
    if wide:
        return _wide(table, stems, wide)
    raise InputError(
        "no columns of corners are recognised",
        code="missing-column",
        place=table.name,
        remedy="name them image, camera, board, point, u_px, v_px; the columns are "
        f"{listed(table.names, 20)}",
    )


def is_corners(names: Sequence[str]) -> bool:
    """Whether these names of columns are those of a table of corners.

    Columns u and v are, but for turns u, v, w beside x, y, z; x and y alone, which may be any
    point, are so beside a column of corners.
    """
    stems = [pixel_stem(name) for name in names]
    if {*"xyzuvw"} <= {*stems}:
        return False
    if {"u", "v"} <= {*stems} or len(_wide_columns(stems)) > 1:
        return True
    has_pixels = None not in (_column("u", stems), _column("v", stems))
    return has_pixels and _column("point", stems) is not None and "z" not in stems


def pixel_stem(name: str) -> str:
    """The name of a column without its unit px."""
    return _PIXELS.sub("", heading(name).stem)


def _stem(name: str, table: Table, spoken: Mapping[str, str]) -> str:
    one = heading(name, spoken)
    stem = _PIXELS.sub("", one.stem)
    if one.unit is not None and stem in ("u", "v"):
        raise InputError(
            f"the column {name!r} is in {one.unit}, and corners are in px",
            code="wrong-unit",
            place=table.name,
            remedy="write pixels, and the header u_px or v_px",
        )
    return stem


def _column(meaning: str, stems: Sequence[str]) -> int | None:
    """Where the column of a meaning stands, by the first of its words that is there; where none
    names the image, its time does."""
    spoken = words("corners", meaning)
    spoken += words("columns", "time") if meaning == "image" else ()
    return next((stems.index(w) for w in spoken if w in stems), None)


def _long(table: Table, stems: Sequence[str]) -> CornerTable:
    count = len(table.rows)
    every = np.arange(count)

    def names(meaning: str, otherwise: str) -> tuple[str, ...]:
        at = _column(meaning, stems)
        return (otherwise,) * count if at is None else table.ids(at)

    def values(meaning: str) -> Array | None:
        at = _column(meaning, stems)
        return None if at is None else table.numbers(at, every)

    images, cameras = names("image", "1"), names("camera", "")
    if not any(cameras):
        split = [split_name(image) for image in images]
        images, cameras = tuple(s[0] for s in split), tuple(s[1] or "1" for s in split)
    boards = names("board", "board")
    tag, point = _column("tag", stems), _column("point", stems)
    u, v, level = values("u"), values("v"), values("level")
    assert u is not None
    assert v is not None
    if tag is not None and point is not None:
        points = tuple(f"{t}.{k}" for t, k in zip(table.ids(tag), table.ids(point), strict=True))
    elif (named := tag if point is None else point) is not None:
        points = table.labels(named)
    else:
        points = _counted(list(zip(images, cameras, boards, strict=True)), u, table)
    if level is not None:
        # mrcal marks a corner that is to be left out by a level of "-".
        u = np.where(np.isnan(level), np.nan, u)
    columns = (images, cameras, boards, points)
    if _column("image", stems) is None and len({*zip(*columns, strict=True)}) < count:
        raise InputError(
            "no column is recognised that says in which image a corner was seen",
            code="missing-column",
            place=table.name,
            remedy=f"name it image; the columns are {listed(table.names, 20)}",
        )
    return _made(columns, u, v, values("sd"), level, table.name, table)


def _counted(groups: Sequence[Any], u: Array, table: Table) -> tuple[str, ...]:
    """Points by their order in each image, where every image has all of them."""
    counts: dict[Any, int] = {}
    points = []
    for group in groups:
        counts[group] = counts.get(group, -1) + 1
        points.append(str(counts[group]))
    # An image without any corner has one row that says so.
    empty = {group for group, last in counts.items() if last == 0}
    sizes = {last for group, last in counts.items() if group not in empty}
    if len(sizes) > 1:
        least = min((g for g in counts if g not in empty), key=lambda g: counts[g])
        raise InputError(
            f"no column names the corners, and image {least[0]!r} has {counts[least] + 1} of them "
            f"where another has {max(sizes) + 1}",
            code="missing-column",
            place=table.place(groups.index(least)),
            remedy="add a column point with the id of each corner, or write - for those not seen",
        )
    return tuple(points)


def split_name(name: str) -> tuple[str, str]:
    """The image and the camera that the name of a file states; "" where it states no camera.

    >>> split_name("frame0012-cam1.jpg"), split_name("left03.png"), split_name("images/7.png")
    (('frame0012', 'cam1'), ('03', 'left'), ('images/7', ''))
    """
    stem = re.sub(r"\.(?:png|jpe?g|bmp|tiff?|pgm|ppm|webp)$", "", name, flags=re.IGNORECASE)
    folder, slash, last = stem.rpartition("/")
    match = _CAMERA.search(last) or _CAMERA_FIRST.match(last)
    if match:
        rest = (last[: match.start()] + last[match.end() :]).strip("-_. ")
        if rest:
            return folder + slash + rest, match["camera"]
    folder_last = folder.rpartition("/")[2]
    if re.fullmatch(r"cam(?:era)?[-_]?\d+|left|right", folder_last, re.IGNORECASE):
        return last, folder_last
    return stem, ""


def _wide_columns(stems: Sequence[str]) -> dict[str, dict[str, int]]:
    """Point -> axis "u" or "v" -> position of the column, of points that have both and no z."""
    columns: dict[str, dict[str, int]] = {}
    for i, stem in enumerate(stems):
        match = next((m for one in _WIDE if (m := one.fullmatch(stem))), None)
        if match:
            axis = {"x": "u", "y": "v"}.get(match["axis"], match["axis"])
            columns.setdefault(match["point"].replace("_", "."), {})[axis] = i
    return {point: axes for point, axes in columns.items() if {*axes} == {"u", "v"}}


def _wide(table: Table, stems: Sequence[str], wide: Mapping[str, Mapping[str, int]]) -> CornerTable:
    count = len(table.rows)
    every = np.arange(count)
    at = {meaning: _column(meaning, stems) for meaning in ("image", "camera", "board")}
    images = tuple(map(str, every)) if at["image"] is None else table.ids(at["image"])
    cameras = ("1",) * count if at["camera"] is None else table.ids(at["camera"])
    boards = ("board",) * count if at["board"] is None else table.ids(at["board"])
    uv = np.array([[table.numbers(axes[a], every) for a in "uv"] for axes in wide.values()])
    # Row after row of the table, all its points.
    u, v = (uv[:, k].T.ravel() for k in (0, 1))
    each = np.repeat(every, len(wide))
    columns = (
        tuple(images[i] for i in each),
        tuple(cameras[i] for i in each),
        tuple(boards[i] for i in each),
        tuple(wide) * count,
    )
    return _made(columns, u, v, None, None, table.name)


_Columns = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], tuple[str, ...]]


def _made(
    columns: _Columns,
    u: Array,
    v: Array,
    sd: Array | None,
    level: Array | None,
    name: str,
    table: Table | None = None,
) -> CornerTable:
    """Corners that were seen; InputError for one that stands twice, and for a negative sd."""
    # Detectors write (-1, -1) or (0, 0) for a corner that they do not see.
    marked = (u == v) & (u <= 0.0)
    seen = np.flatnonzero(np.isfinite(u) & np.isfinite(v) & ~marked)
    every = CornerTable(*columns, u, v, sd, level, name)
    if not seen.size:
        raise InputError(
            "no corner is seen in any image",
            code="no-data",
            place=name,
            remedy="check the columns of u and v, and the detector",
        )
    met: set[tuple[str, ...]] = set()
    for i in seen.tolist():
        key = tuple(names[i] for names in columns)
        place = name if table is None else table.place(i)
        if key in met:
            image, camera, board, point = key
            raise InputError(
                f"corner {point!r} of board {board!r} stands twice in image {image!r} of camera "
                f"{camera!r}",
                code="duplicate-name",
                place=place,
                remedy="remove one of the rows, or name the camera in a column of its own",
            )
        met.add(key)
        if sd is not None and sd[i] < 0.0:
            raise InputError(
                f"the sd of a corner is {sd[i]:g} px",
                code="invalid-value",
                place=place,
                remedy="state sds that are positive, or remove the column",
            )
    return every.at(seen)


def _in_document(document: Part) -> tuple[_Columns, Array, Array, None, None]:
    rows = corners_in(document)
    if not rows:
        raise InputError(
            "no corners are recognised",
            code="missing-key",
            place=document.place,
            remedy='write for each image {"image": "1.png", "ids": [0, 1], "corners": [[u, v], '
            '...]}, or a list of {"tag_id": 0, "corners": [[u, v], ...]}',
        )
    split = [split_name(image) for image, *_ in rows]
    columns = (
        tuple(s[0] for s in split),
        tuple(s[1] or "1" for s in split),
        ("board",) * len(rows),
        tuple(point for _, point, _, _ in rows),
    )
    u, v = (np.array([row[k] for row in rows]) for k in (2, 3))
    return columns, u, v, None, None
