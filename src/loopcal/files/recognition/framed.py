"""The table of a file among other lines: titles above it, a header of several rows, units, remarks.

The readings are the rows that hold numbers and are as wide as most of such rows. The rows without
numbers right above them are the header: the fullest names the columns, those above it tell apart
columns of one name (merged cells count for all that they span), and one of units states these.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.recognition.headers import heading
from loopcal.files.recognition.joint_sets import names_joints
from loopcal.files.recognition.records import MARKS, are_records, has_numbers, records_table
from loopcal.files.tables.cells import is_missing, is_number, number
from loopcal.files.tables.delimited import DELIMITERS, cut
from loopcal.files.tables.raw import Text, read_text
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.registry import TEXT, reader_of
from loopcal.files.tables.table import Table
from loopcal.presentation.shown import enumerated

_MOST, _FEWEST = 6, 3
"""Rows of a header at most, and rows of readings that a table among other lines has at least."""
_LOOKED = 15
"""Rows that may still be titles, or the header."""
_MOST_BYTES = 20_000_000
"""Of a text that is searched for a table: all of it is cut in each way that it may be written."""

Row = Sequence[object]


@dataclass(frozen=True)
class _Frame:
    """Positions of the rows of a table among others.

    names: of its columns, empty where nothing names them; body: rows of readings; below: so many
    rows after the last.
    """

    names: tuple[str, ...]
    body: list[int]
    below: int

    @property
    def score(self) -> tuple[int, int]:
        """Rows of readings, and columns that have a name."""
        return len(self.body), sum(map(bool, self.names))


def framed_table(path: Path, part: str | int | None, fewest: int) -> tuple[Table, str]:
    """The table of a file, and what to say of the rows around it.

    fewest: columns that the header names at least, where rows around the table are left out.

    Raises the reader's InputError where no table is found either.
    """
    try:
        table = read_table(path, **({} if part is None else {reader_of(path).part: part}))
    except InputError:
        if reader_of(path) is not TEXT or (text := _searched(path)) is None:
            raise
        among_lines = _in_text(text, fewest)
        if among_lines is None and not has_numbers(text):
            raise InputError(
                "this text has no line with two numbers, so it holds no readings",
                code="no-data",
                place=str(path),
                remedy="name files with a row per pose, and a column per joint and reading",
            ) from None
        if among_lines is None:
            raise
        return among_lines
    table, again = _without_headers(table)
    table, remark = with_units_in_names(table)
    if remark or again:
        return table, f"{again} {remark}".strip()
    if not _suspect(table):
        return table, ""
    if reader_of(path) is TEXT:
        text = _searched(path)
        return (text and _in_text(text, fewest)) or (table, "")
    return _in_cells(table, fewest)


def _without_headers(table: Table) -> tuple[Table, str]:
    """The table without rows that repeat its header, and what to say of them, "" for none."""
    if not any(table.names) or any(not isinstance(cells, list) for cells in table.columns.values()):
        return table, ""
    named = [(name.strip(), table.columns[i]) for i, name in enumerate(table.names) if name]
    again = [
        k
        for k in range(len(table.rows))
        if all(str(cells[k] or "").strip() == name for name, cells in named)
    ]
    if not again:
        return table, ""
    left = np.delete(np.arange(len(table.rows)), again)
    columns = {i: [cells[int(k)] for k in left] for i, cells in table.columns.items()}
    rows = enumerated([str(table.rows[k]) for k in again])
    many = "Row" if len(again) == 1 else "Rows"
    words = f"{many} {rows} of {table.name} repeat{'s' * (len(again) == 1)} the header: left out."
    return replace(table, columns=columns, rows=table.rows[left]), words


def _suspect(table: Table) -> bool:
    """Whether what was taken for the header may be a title, or only a part of the header."""
    if any(not isinstance(cells, list) for cells in table.columns.values()):
        return False
    numeric = [table.columns[i] for i in table.numeric()]
    width = max(table.columns, default=-1) + 1
    texts = [cells for i, cells in table.columns.items() if i not in table.numeric()]
    if not table.names and any(all(MARKS & {*str(c)} for c in cells) for cells in texts):
        return True
    if not numeric or (table.names and sum(map(bool, table.names)) < width - 1):
        return True
    rows = zip(*(cells[:_LOOKED] for cells in numeric), strict=True)
    return any(
        not any(is_number(c, table.decimal) for c in row) and not all(map(is_missing, row))
        for row in rows
    )


def _in_cells(table: Table, fewest: int) -> tuple[Table, str]:
    """What stands below the header in a sheet."""
    width = max(table.columns, default=-1) + 1
    names = [*table.names, *[""] * (width - len(table.names))]
    rows: list[Row] = [names, *zip(*(table.columns[i] for i in range(width)), strict=True)]
    frame = _frame(rows, table.decimal)
    if frame is None or sum(map(bool, frame.names)) < fewest:
        return table, ""
    below = {i: [rows[k][i] for k in frame.body] for i in range(width)}
    number = table.rows[np.array(frame.body) - 1]
    made = replace(table, names=frame.names, columns=below, rows=number)
    return made, _remark(table.name, int(number[0]) - 1, frame)


def _searched(path: Path) -> Text | None:
    """The text of a file; None of what is none, or is too long."""
    if not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return None
    try:
        return read_text(path)
    except InputError:
        return None


def _in_text(text: Text, fewest: int) -> tuple[Table, str] | None:
    """The table among the lines of a text; None where there is none."""
    lines = text.data.decode("utf-8").split("\n")
    if are_records(lines):
        return records_table(text) or _among(lines, text, fewest)
    return _among(lines, text, fewest) or records_table(text)


def _among(lines: Sequence[str], text: Text, fewest: int) -> tuple[Table, str] | None:
    """The table in some of these lines."""
    # Tables of Markdown have a bar at both ends of a row.
    barred = sum(line.strip()[:1] == "|" == line.strip()[-1:] for line in lines) >= _FEWEST
    ways = [(d, m) for d in (("|",) if barred else DELIMITERS) for m in ".,"]
    found = [(made[0].score, made) for way in ways if (made := _cut_so(lines, text, *way))]
    if not found:
        return None
    _, (frame, table) = max(found, key=lambda one: one[0])
    if frame.names and sum(map(bool, frame.names)) < fewest:
        return None
    return table, _remark(text.name, int(table.rows[0]) - 1, frame)


def _cut_so(
    lines: Sequence[str], text: Text, delimiter: str, decimal: str
) -> tuple[_Frame, Table] | None:
    rows: list[Row] = []
    for line in lines:
        try:
            rows.append(cut(line, delimiter) if line.strip() else [])
        except csv.Error:
            rows.append([])
    frame = _frame(rows, decimal)
    if frame is None:
        return None
    width = len(rows[frame.body[0]])
    columns = {i: [str(rows[k][i]) for k in frame.body] for i in range(width)}
    number = np.array(frame.body, dtype=np.int64) + 1
    return frame, Table(text.file, None, text.sha256, frame.names, columns, number, decimal)


def _frame(rows: Sequence[Row], decimal: str) -> _Frame | None:
    """Where the table is; None where rows of other widths stand between its readings."""
    counts = [sum(is_number(cell, decimal) for cell in row) for row in rows]
    widths = Counter(len(row) for row, count in zip(rows, counts, strict=True) if count > 1)
    if not widths:
        return None
    width = max(widths, key=lambda w: (w * widths[w], w))
    alike = [i for i, row in enumerate(rows) if len(row) == width and counts[i] > 1]
    # A line of a title may hold two numbers by chance; readings have their like below them.
    usual = float(np.median([counts[i] for i in alike]))
    begins = next((i for i in alike if counts[i] >= usual), None)
    if begins is None:
        return None
    last = alike[-1]
    above = {tuple(row) for row in rows[:begins]}  # a header may stand again among the readings
    body = [
        i for i in range(begins, last + 1) if not _blank(rows[i]) and tuple(rows[i]) not in above
    ]
    if len(body) < _FEWEST or any(len(rows[i]) != width for i in body):
        return None
    header = _header(rows[:begins], width, decimal)
    below = sum(not _blank(row) for row in rows[last + 1 :])
    return _Frame(_joined(header, width, decimal), body, below)


def _header(above: Sequence[Row], width: int, decimal: str) -> list[list[str]]:
    """The rows right above the readings that may name their columns, the uppermost first."""
    made: list[list[str]] = []
    for row in reversed(above):
        cells = ["" if is_missing(cell) else str(cell).strip() for cell in row]
        cells += [""] * (width - len(cells))
        filled = sum(map(bool, cells))
        if not filled:
            continue
        # One cell alone is a title, unless it names the index of the rows right below.
        title = filled == 1 and (bool(made) or not cells[0] or len(row) == 1)
        if title or len(cells) > width or any(is_number(c, decimal) for c in cells if c):
            break
        made.append(cells)
        if len(made) == _MOST:
            break
    return made[::-1]


def _joined(header: list[list[str]], width: int, decimal: str) -> tuple[str, ...]:
    """The names of the columns by all rows of a header."""
    units = [row for row in header if _units(row)]
    naming = [row for row in header if not _units(row)]
    if not naming:
        return ()
    full = max(range(len(naming)), key=lambda k: (sum(map(bool, naming[k])), k))
    names = [*naming[full]]
    for row in naming[full - 1 :: -1] if full else ():
        twice = {name for name, count in Counter(names).items() if count > 1 and name}
        spread = _spread(row)
        groups = {spread[i] for i in range(width) if names[i] in twice}
        if len(groups) > 1:
            each = zip(names, spread, strict=True)
            names = [f"{g} {n}" if n and g in groups else n for n, g in each]
    for row in units:
        names = [f"{n} [{u}]" if n and u else n for n, u in zip(names, row, strict=True)]
    return tuple(names)


def _units(row: Sequence[str]) -> bool:
    """Whether a row states units and nothing else."""
    stated = [cell.strip("[]() ") for cell in row if cell]
    return bool(stated) and all(heading(f"x [{cell}]").stem == "x" for cell in stated)


def _spread(row: Sequence[str]) -> list[str]:
    """A row with each cell in the empty ones behind it, as merged cells show it."""
    spread, last = list[str](), ""
    for cell in row:
        last = cell or last
        spread.append(last)
    return spread


def _blank(row: Row) -> bool:
    return not row or all(is_missing(cell) for cell in row) or str(row[0]).startswith(("#", "%"))


def _remark(name: str, above: int, frame: _Frame) -> str:
    rows = "The first row" if above == 1 else f"The first {above} rows"
    words = [f"{rows} of {name} {'is no reading' if above == 1 else 'are no readings'}."]
    if frame.names and above > 1:
        words.append(f"They name the columns {', '.join(filter(None, frame.names))}.")
    if frame.below:
        words.append(f"What stands below row {frame.body[-1] + 1} is no reading either.")
    return " ".join(words)


# Cells that hold their unit: `12.5°`, `1,234.5 mm`, `48° 12' 30.5"`. It moves into the header.


_WITH_UNIT = re.compile(
    r"(?P<number>[-+]?[\d.,]{1,40}(?:[eE][-+]?\d{1,4})?)\s{0,3}(?P<unit>\D{1,12})"
)
_ARC = re.compile(
    r"(?P<sign>[-+]?)(?P<deg>\d{1,4})\s?[°d:]\s?(?P<min>\d{1,2})\s?['′’m:]\s?"
    r"(?P<sec>\d{1,2}(?:[.,]\d{0,9})?)\s?(?:[\"″”s]|'')?"
)


def with_units_in_names(table: Table) -> tuple[Table, str]:
    """The table with the units of cells in its header, and what to say of it, "" for none.

    A column is read so where each of its cells has the same unit.
    """
    columns, names = {**table.columns}, [*table.names]
    names += [""] * (1 + max(columns, default=-1) - len(names))
    moved = []
    for i, cells in table.columns.items():
        if isinstance(cells, list) and (made := _numbers(cells, table.decimal, names[i])):
            columns[i], unit = made
            names[i] = f"{names[i] or f'column {i + 1}'} [{unit}]"
            moved.append(names[i])
    if not moved:
        return table, ""
    made_table = replace(table, names=tuple(names), columns=columns)
    return made_table, f"The cells of {table.name} hold units: {listed(moved)} are read so."


def _numbers(cells: Sequence[object], decimal: str, name: str) -> tuple[list[object], str] | None:
    """The numbers of cells with one unit, and the unit; None for others."""
    first = next((cell for cell in cells if not is_missing(cell)), None)
    if first is None or is_number(first, decimal):
        return None
    present = [str(cell).strip() for cell in cells if not is_missing(cell)]
    # 10:15:30 is a time of day; with a ° it is an angle, whatever stands between its parts
    if all(_ARC.fullmatch(cell) for cell in present) and ("°" in present[0] or "'" in present[0]):
        return [_degrees(str(cell)) if not is_missing(cell) else None for cell in cells], "deg"
    made: list[object] = []
    units = set()
    for cell in cells:
        match = _WITH_UNIT.fullmatch(str(cell).strip())
        if is_missing(cell):
            made.append(None)
        elif match and is_number(match["number"], decimal):
            made.append(number(match["number"], decimal))
            units.add(heading(f"x [{match['unit']}]").unit)
        else:
            return None
    unit = units.pop() if len(units) == 1 else None
    stated = heading(name).unit if name else None
    return (made, unit) if unit and stated in (None, unit) else None


def _degrees(cell: str) -> float:
    match = _ARC.fullmatch(cell.strip())
    assert match
    size = int(match["deg"]) + int(match["min"]) / 60 + float(match["sec"].replace(",", ".")) / 3600
    return -size if match["sign"] == "-" else size


# A table with a column per pose or joint, the first naming them: its rows become columns.


_FEWEST_KEYS = 4
"""Rows that name a quantity, at least."""
_ROWS = 3
"""Such rows for each column beside them, at most: names of points have three coordinates each."""


def matrices_unfolded(table: Table) -> tuple[Table, str]:
    """A table of 4x4 matrices below each other with a row for each, and what to say of it, "" where
    it holds none: every fourth row is 0, 0, 0, 1."""
    count, four = len(table.rows), [0, 1, 2, 3]
    if sorted(table.columns) != four or [*table.numeric()] != four or count % 4:
        return table, ""
    cells = np.array([table.numbers(i, np.arange(count)) for i in range(4)]).T
    if not (cells[3::4] == np.eye(4)[3]).all():
        return table, ""
    rows = cells.reshape(-1, 16)
    names = tuple(f"T{i}{j}" for i in range(1, 5) for j in range(1, 5))
    columns = dict(enumerate(rows.T))
    numbers = np.arange(1, len(rows) + 1, dtype=np.int64)
    made = replace(table, names=names, columns=columns, rows=numbers)
    return made, f"{table.name} holds {len(rows)} matrices of four rows: one for each pose."


def turned_over(
    table: Table, names: Callable[[Sequence[str]], bool] = names_joints
) -> tuple[Table, str]:
    """The table with a row per pose, and what to say of it, "" where it has one already.

    The words of the first column are names of this kind, and the header has none.
    """
    width = 1 + max(table.columns, default=-1)
    if any(not isinstance(c, list | np.ndarray) for c in table.columns.values()) or width < 2:
        return table, ""
    rows = list(zip(*(table.columns[i] for i in range(width)), strict=True))
    named = [row for row in rows if str(row[0] or "").strip() and is_number(row[1], table.decimal)]
    words = [str(row[0]).strip() for row in named]
    if not _FEWEST_KEYS <= len(named) <= _ROWS * (width - 1):
        return table, ""
    if len(named) < len(rows) - 1 or len({*words}) < len(words):
        return table, ""
    if not names(words) or names(table.names):
        return table, ""
    ids = [str(name) or str(i) for i, name in enumerate(table.names[1:width], 1)]
    columns = {0: ids or [*map(str, range(1, width))]}
    columns |= {i: [*row[1:]] for i, row in enumerate(named, 1)}
    made = replace(
        table,
        names=("pose", *words),
        columns=columns,
        rows=np.arange(1, width, dtype=np.int64),
    )
    return made, f"{table.name} has a column per pose: its rows are read as columns."
