"""Boards as other programs describe them, as tables of points, and as keys of a project.

Kalibr target         target_type: aprilgrid (tagCols, tagRows, tagSize, tagSpacing),
                      checkerboard (targetCols, targetRows, rowSpacingMeters,
                      colSpacingMeters), circlegrid (spacingMeters, asymmetricGrid)
a description         type: checkerboard, charuco, aprilgrid or circles, its counts and sizes
industrial_calibration  rows, cols, chessboard_dim, aruco_marker_dim, ...
RWHEC of Tabb         a text: chess_mm_height 28.5, chess_mm_width, chess_height, chess_width
a table of points     board, point, x, y, z with units in the header, [m] without
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from loopcal.errors import InputError, listed, placed, unknown_name
from loopcal.files.cameras.document import DOCUMENTS, Part, read_document
from loopcal.files.recognition.headers import heading, words
from loopcal.files.tables.readers import read_table
from loopcal.mechanisms.cameras import printed
from loopcal.mechanisms.cameras.board import Board
from loopcal.units import to_si, unit

_NUMBERED = (
    *(f"{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    *("ARUCO_ORIGINAL", "APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11"),
)
"""Dictionaries in the order in which OpenCV numbers them."""


_NAME = "board"
"""Of a board that its file gives no name."""
_FINDER = re.compile(r"(?:_?grid)?(?:_?target)?(?:_?finder)?(?:_?plugin)?$")
"""Ends of the names by which plugins of industrial_calibration find boards."""


def read_boards(path: str | Path) -> dict[str, Board]:
    """The boards of a file by name, "board" where it names none.

    Raises InputError for a kind that is not known, sizes that are not positive, and a table without
    the columns x and y, or with one point twice.
    """
    if Path(path).suffix.lower() not in DOCUMENTS:
        return {_NAME: _chess(path)} if is_chess(path) else _of_table(path)
    document = read_document(path)
    described = document.get("board", "target", "target_finder", "target_definition") or document
    if isinstance(described.data, list):
        described = described.parts()[0]
    return {_NAME: _board_of(described)}


_CHESS = ("chess_mm_height", "chess_mm_width", "chess_height", "chess_width")
"""Words of a text that describes a checkerboard, each before its number: sizes and counts."""
_LONGEST = 2_000
"""Bytes of such a text at most."""


def is_chess(path: str | Path) -> bool:
    """Whether a text describes a checkerboard by the words of RWHEC."""
    return Path(path).suffix.lower() == ".txt" and {*_CHESS} <= {*_by_word(path)}


def _chess(path: str | Path) -> Board:
    stated = Part(_by_word(path), Path(path).name)
    tall, wide, rows, columns = (stated.part(word) for word in _CHESS)
    pitch = (1e-3 * wide.length, 1e-3 * tall.length)
    return printed.checkerboard(columns.count, rows.count, pitch, _NAME)


def _by_word(path: str | Path) -> dict[str, str]:
    """What stands behind the first word of each line; nothing of a text that is longer, or none."""
    try:
        with Path(path).open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except (OSError, UnicodeDecodeError):
        return {}
    if len(text) > _LONGEST:
        return {}
    lines = (line.split() for line in text.splitlines())
    return {line[0]: line[1] for line in lines if len(line) == 2}


def _board_of(part: Part) -> Board:
    """The board of a description: its kind, counts and sizes [m, or in its `unit`].

    Raises InputError as `read_boards`.
    """
    kind = (part.get("target_type", "type", "kind") or Part(_guessed(part), part.place)).text
    with placed(part.place, unless_stated=True):
        match _FINDER.sub("", kind.lower().rpartition(":")[2]).strip("_ "):
            case "april" | "apriltag":
                counts = _counts(part, "tag")
                size = _size(part, "size", "tagSize", "tag_size")
                spacing = part.part("spacing", "tagSpacing", "tag_spacing").number
                return printed.aprilgrid(*counts, size, spacing, _NAME)
            case "checkerboard" | "chessboard":
                counts = _counts(part, "corner")
                if part.get("columns", "cols") is None and "squares_x" in part:
                    # Of a board of squares its inner corners are seen.
                    counts = (counts[0] - 1, counts[1] - 1)
                pitch = (
                    _size(part, *_SQUARE, "colSpacingMeters"),
                    _size(part, *_SQUARE, "rowSpacingMeters"),
                )
                return printed.checkerboard(*counts, pitch, _NAME)
            case "charuco":
                return _charuco(part)
            case "circle" | "circles" | "asymmetric circles" | "modifiedcircle":
                flag = part.get("asymmetricGrid", "asymmetric")
                asymmetric = kind == "asymmetric circles" or bool(flag and flag.flag)
                spacing = _size(part, "spacing", "spacingMeters", "pitch", "circle_spacing")
                return printed.circles(
                    *_counts(part, "circle"), spacing, _NAME, asymmetric=asymmetric
                )
    raise unknown_name(f"there is no kind of board {kind!r}", kind, printed.KINDS, part.place)


_ACROSS, _DOWN = ("board_width", "width"), ("board_height", "height")
_MARKER = ("marker", "marker_m", "marker_size", "marker_length", "aruco_marker_dim")
_SQUARE = ("square", "square_m", "square_size", "squareSize", "square_length", "chessboard_dim")


def _charuco(part: Part) -> Board:
    stated = part.get("squares", "size")
    squares = [one.count for one in stated.parts()] if stated else list(_counts(part, "squares"))
    if len(squares) != 2:
        raise part.part("squares", "size").wrong("two counts, along x and along y")
    marker = part.get(*_MARKER)
    legacy = part.get("legacy", "legacy_pattern")
    dictionary = part.get("dictionary")
    word = dictionary.text.upper().removeprefix("DICT_") if dictionary else ""
    if word.isdigit() and int(word) < len(_NUMBERED):
        word = _NUMBERED[int(word)]
    return printed.charuco(
        (squares[0], squares[1]),
        _size(part, *_SQUARE),
        marker.length * _factor(part) if marker else 0.0,
        word,
        _NAME,
        legacy=bool(legacy and legacy.flag),
    )


def _guessed(part: Part) -> str:
    """The kind of a board that states none, by its keys."""
    if part.get("chessboard_dim", "squares", "squares_x"):
        return "charuco" if part.get(*_MARKER) else "checkerboard"
    if "spacing" in part and "rows" in part:
        return "circles"
    if "tagCols" in part:
        return "aprilgrid"
    return "checkerboard" if part.get(*_SQUARE) and part.get("columns", "cols", *_ACROSS) else ""


def _counts(part: Part, what: str) -> tuple[int, int]:
    columns = part.part("columns", "cols", f"{what}Cols", "targetCols", "squares_x", *_ACROSS)
    rows = part.part("rows", f"{what}Rows", "targetRows", "squares_y", *_DOWN)
    return columns.count, rows.count


def _size(part: Part, *names: str) -> float:
    return part.part(*names).length * _factor(part)


def _factor(part: Part) -> float:
    stated = part.get("unit")
    if stated is None:
        return 1.0
    with placed(stated.place):
        if unit(stated.text).dimension != "length":
            raise stated.wrong("a unit of length")
        return unit(stated.text).factor


def _of_table(path: str | Path) -> dict[str, Board]:
    table = read_table(path)
    every = np.arange(len(table.rows))
    headings = {i: heading(name) for i, name in enumerate(table.names)}
    stems = {one.stem: i for i, one in reversed(headings.items())}

    def column(meaning: str) -> int | None:
        return next((stems[w] for w in words("corners", meaning) if w in stems), None)

    axes = [stems.get(axis) for axis in "xyz"]
    if axes[0] is None or axes[1] is None:
        raise InputError(
            "the points of a board have no columns x and y",
            code="missing-column",
            place=table.name,
            remedy=f"name them x_m, y_m, z_m; the columns are {listed(table.names, 20)}",
        )
    xyz = np.zeros((3, len(every)))
    for k, i in enumerate(axes):
        if i is not None:
            with placed(table.name):
                xyz[k] = to_si(table.numbers(i, every), headings[i].unit or "m")
    ids_at, boards_at = column("point"), column("board")
    ids = tuple(map(str, every)) if ids_at is None else table.labels(ids_at)
    names = (_NAME,) * len(ids) if boards_at is None else table.ids(boards_at)
    boards: dict[str, dict[str, tuple[float, float, float]]] = {}
    for row, (name, one) in enumerate(zip(names, ids, strict=True)):
        points = boards.setdefault(name, {})
        if one in points or not np.isfinite(xyz[:, row]).all():
            raise InputError(
                f"the point {one!r} stands twice" if one in points else "a coordinate is missing",
                code="duplicate-name" if one in points else "missing-reading",
                place=table.place(row),
                remedy="state each point of a board once, with x and y",
            )
        points[one] = tuple(xyz[:, row].tolist())
    return {name: Board(name, points) for name, points in boards.items()}
