"""Boards as they are printed: which points their patterns have, and what they are called.

Grids have the ids 0, 1, ... row by row, x along a row and y from row to row, with the first point
at the origin; those of a ChArUco board begin one square inside its corner, as in OpenCV 4.6 and
later. An AprilGrid has the corners "TAG.CORNER", tags and corners as Kalibr counts them: tags row
by row from the bottom left, corners 0 to 3 of a tag from its bottom left counterclockwise.
"""

from __future__ import annotations

from loopcal.errors import InputError
from loopcal.mechanisms.cameras.board import Board, Pattern

KINDS = ("checkerboard", "charuco", "aprilgrid", "circles", "asymmetric circles")
_MOST = 100_000
"""Points of a board; more than any camera resolves."""


def checkerboard(
    columns: int, rows: int, square: float | tuple[float, float], name: str = "board"
) -> Board:
    """The inner corners of a checkerboard; square: its side, or its width and height [m]."""
    return _grid(Pattern("checkerboard", columns, rows), square, name)


def circles(
    columns: int,
    rows: int,
    spacing: float | tuple[float, float],
    name: str = "board",
    *,
    asymmetric: bool = False,
) -> Board:
    """The centres of circles; spacing [m], along a row and from row to row.

    asymmetric: every second row is shifted by `spacing`, and circles of a row are twice as far
    apart, as in OpenCV.
    """
    if not asymmetric:
        return _grid(Pattern("circles", columns, rows), spacing, name)
    pattern = Pattern("asymmetric circles", columns, rows)
    across, along = _pitches(spacing, name)
    _check(pattern, name)
    cells = [(i, j) for j in range(rows) for i in range(columns)]
    points = [((2 * i + j % 2) * across, j * along, 0.0) for i, j in cells]
    return Board(name, dict(zip(map(str, range(len(points))), points, strict=True)), pattern)


def charuco(
    squares: tuple[int, int],
    square: float | tuple[float, float],
    marker: float = 0.0,
    dictionary: str = "",
    name: str = "board",
    *,
    legacy: bool = False,
) -> Board:
    """The chessboard corners of a ChArUco board.

    squares: along x and along y; square, marker: sides [m]; dictionary: of the markers, as in
    OpenCV; legacy: printed by OpenCV before 4.6. The last three matter in images alone.
    """
    columns, rows = squares
    width, height = _pitches(square, name)
    pattern = Pattern("charuco", columns, rows, marker / width, dictionary, legacy)
    inside = _grid(Pattern("charuco", columns - 1, rows - 1), (width, height), name)
    points = {i: (x + width, y + height, z) for i, (x, y, z) in inside.points.items()}
    return Board(name, points, pattern)


def aprilgrid(
    columns: int,
    rows: int,
    size: float,
    spacing: float,
    name: str = "board",
    dictionary: str = "APRILTAG_36h11",
) -> Board:
    """The corners of tags; size: of a tag [m]; spacing: the gap between tags over their size."""
    size, _ = _pitches(size, name)
    _, spacing = _pitches((1.0, spacing), name)
    pattern = Pattern("aprilgrid", columns, rows, 1.0 / (1.0 + spacing), dictionary)
    _check(pattern, name)
    corners = ((0.0, 0.0), (size, 0.0), (size, size), (0.0, size))
    step = size * (1.0 + spacing)
    points = {
        f"{columns * j + i}.{k}": (i * step + x, j * step + y, 0.0)
        for j in range(rows)
        for i in range(columns)
        for k, (x, y) in enumerate(corners)
    }
    return Board(name, points, pattern)


def _grid(pattern: Pattern, pitch: float | tuple[float, float], name: str) -> Board:
    _check(pattern, name)
    across, along = _pitches(pitch, name)
    cells = [(i, j) for j in range(pattern.rows) for i in range(pattern.columns)]
    points = {str(n): (i * across, j * along, 0.0) for n, (i, j) in enumerate(cells)}
    return Board(name, points, pattern)


def _pitches(pitch: float | tuple[float, float], name: str) -> tuple[float, float]:
    across, along = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    if not (0.0 < across < 1e6 and 0.0 < along < 1e6):
        raise InputError(
            f"the size {pitch} of a square, gap or circle of the board {name!r} is not positive",
            code="invalid-value",
            remedy="measure it on the print, and state it with its unit",
        )
    return float(across), float(along)


def _check(pattern: Pattern, name: str) -> None:
    if min(pattern.columns, pattern.rows) < 1 or pattern.columns * pattern.rows > _MOST:
        raise InputError(
            f"the board {name!r} has {pattern.columns} x {pattern.rows} points or tags",
            code="invalid-value",
            remedy=f"state at least one column and row, and at most {_MOST:,} points",
        )
