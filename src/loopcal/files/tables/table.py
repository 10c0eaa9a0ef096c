"""A table as it was found in a file: named or numbered columns of cells, and where each row is."""

from __future__ import annotations

import re
from ast import literal_eval
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, nearest, short
from loopcal.files.tables import cells as cell_rules
from loopcal.files.tables.cells import Cells, NotANumber
from loopcal.measurements.days import Days
from loopcal.measurements.poses import cell_text
from loopcal.measurements.source import file_name, row_name

_TENTHS = re.compile(r"\d+\.\d+")
LONGEST = 500
"""Characters of an id, of another text of a row, and of the name of a column."""
ROW = 0
"""The column that every table has: the number of each row of data, from 1."""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of cells, addressed by name or by number from 1; no unit is known here."""

    file: str
    """Name of the file, "-" for standard input."""
    part: str | None
    """The sheet or variable of a file that may hold several."""
    sha256: str
    names: tuple[str, ...]
    """Names of all columns; empty where the file has no header."""
    columns: Mapping[int, Cells]
    """Position from 0 -> cells (N,) of one column; those not asked for may be left out."""
    rows: NDArray[np.int64]
    """(N,) row of each pose in the file, counted from 1."""
    decimal: str = "."
    total: int | None = None
    """Rows of the file where only some are here, of which `rows` tells which; None: all are."""
    begins: Mapping[str, int] = field(default_factory=dict)
    """Of a folder: file -> rows in the files before it; `rows` count through all of them."""

    before: int = 0
    """Rows of data before these, where `rows` count through one file of several."""

    def __post_init__(self) -> None:
        for number, name in enumerate(self.names, 1):
            if len(name) > LONGEST:
                raise InputError(
                    f"the name of column {number} has {len(name)} characters; the limit is "
                    f"{LONGEST}",
                    code="too-large",
                    place=self.name,
                    remedy="correct the header",
                )

    @property
    def counted(self) -> NDArray[np.int64]:
        """(N,) number of each row among all rows of data, from 1."""
        if self.total is not None:
            return self.rows
        return np.arange(self.before + 1, self.before + 1 + len(self.rows), dtype=np.int64)

    @property
    def name(self) -> str:
        """How messages call the table."""
        return file_name(self.file, self.part)

    @property
    def sheet(self) -> str | None:
        """The sheet of a workbook that was read; None of other files."""
        kind, _, name = (self.part or "").partition(" ")
        # The readers write the name with repr, which keeps quotes in it apart.
        return str(literal_eval(name)) if kind == "sheet" else None

    def position(self, column: str | int) -> int:
        """Where a column stands, from 0; InputError naming the nearest if there is none.

        That of row numbers stands before all others, at -1.
        """
        if column == ROW:
            return -1
        width = len(self.names) or len(self.columns)
        return find_column(column, self.names, width, self.name)

    def label(self, position: int) -> str:
        """The column's name, or its number where it has no name."""
        if position < 0:
            return "row number"
        return short(self.names[position] if self.names else "") or str(position + 1)

    def place(self, index: int, position: int | None = None) -> str:
        """File, row and column of a cell for a message, by its place among the rows of data."""
        words = f"{self.name}, {row_name(int(self.rows[index]), self.begins)}"
        return words if position is None else f"{words}, column {self.label(position)!r}"

    def numbers(self, position: int, keep: NDArray[np.int64]) -> NDArray[np.float64]:
        """One column at the rows to keep; InputError for a cell that is not a number."""
        if position < 0:
            return self.counted[keep].astype(np.float64)
        column = self.columns[position]
        try:
            try:
                return cell_rules.numbers(column, keep, self.decimal)
            except NotANumber:
                joined = cell_rules.ungrouped(column, self.decimal)
                if joined is None:
                    raise
                return cell_rules.numbers(joined, keep, self.decimal)
        except NotANumber as wrong:
            text = str(wrong.cell)
            raise InputError(
                f"{short(text)!r} is not a number",
                code="invalid-number",
                place=self.place(wrong.index, position),
                remedy=_remedy(text, self.decimal),
            ) from None

    def first(self, position: int) -> str | None:
        """The first cell of a column as it stands, None where it holds a number."""
        cell = self.columns[position][0]
        return None if cell_rules.is_number(cell, self.decimal) else str(cell or "")

    def ids(self, position: int) -> tuple[str, ...]:
        """One column as ids of poses, all rows."""
        if position < 0:
            return tuple(map(str, self.counted.tolist()))
        pose_ids = cell_rules.ids(self.columns[position])
        if max(map(len, pose_ids), default=0) > LONGEST:
            index = next(i for i, one in enumerate(pose_ids) if len(one) > LONGEST)
            raise InputError(
                f"{short(pose_ids[index])!r} has {len(pose_ids[index])} characters; the limit of "
                f"ids and words is {LONGEST}",
                code="too-large",
                place=self.place(index, position),
                remedy="shorten it, or name the column of the ids",
            )
        return pose_ids

    def labels(self, position: int) -> tuple[str, ...]:
        """One column as names of points: as `ids`, but 4.0 stays where 4.1 is another one, as
        corner 0 and corner 1 of tag 4 are."""
        every = self.ids(position)
        if not any(_TENTHS.fullmatch(one) for one in every):
            return every
        return tuple(f"{one}.0" if one.isdecimal() else one for one in every)

    def numeric(self) -> list[int]:
        """Positions of the columns whose cells are numbers for the most part."""
        return [i for i, c in self.columns.items() if cell_rules.mostly_numbers(c, self.decimal)]

    def days(self, keep: NDArray[np.int64]) -> Days | None:
        """When the rows to keep were measured, by a column of dates as ISO 8601 writes them.

        None without one, and where two of them disagree. No header is needed.
        """
        numeric = set(self.numeric())
        columns = [cells for position, cells in self.columns.items() if position not in numeric]
        days = {_days_of(cells, keep) for cells in columns} - {None}
        # Which of several columns is that of the measurement is not guessed.
        return days.pop() if len(days) == 1 else None


def _days_of(cells: Cells, keep: NDArray[np.int64]) -> Days | None:
    stated = (cells[int(i)] for i in keep)
    return Days.of_moments(str(cell) for cell in stated if not cell_rules.is_missing(cell))


def positions_of(
    wanted: Collection[str | int] | None, names: Sequence[str], place: str
) -> list[int]:
    """Positions from 0 of the columns wanted, all of them for None, rising; see `find_column`."""
    asked = range(1, len(names) + 1) if wanted is None else wanted
    return sorted({find_column(column, names, len(names), place) for column in asked})


def find_column(column: str | int, names: Sequence[str], width: int, place: str) -> int:
    """Position from 0 of a column given by its name, or by its number from 1.

    Raises InputError for one that is absent, with the nearest name and all the names. Raises it
    also for a name that stands twice in the header.
    """
    if isinstance(column, int):
        if 1 <= column <= width:
            return column - 1
        raise InputError(
            f"there is no column {column}",
            code="missing-column",
            place=place,
            remedy=f"give a number from 1 to {width}",
        )
    # A header that looks like a formula may stand behind an apostrophe (docs/decisions/0137).
    label = column if column in names else cell_text(column)
    positions = [i for i, name in enumerate(names) if name == label]
    if len(positions) == 1:
        return positions[0]
    if positions:
        numbers = " and ".join(str(i + 1) for i in positions[:3]) + (
            " and more" if positions[3:] else ""
        )
        raise InputError(
            f"the header has {column!r} more than once (columns {numbers})",
            code="duplicate-column",
            place=place,
            remedy="rename one of them, or give the column by its number",
        )
    if not names:
        raise InputError(
            f"there is no column {column!r}: the file has no header",
            code="missing-column",
            place=place,
            remedy=f"give the column by its number, from 1 to {width}",
        )
    close = nearest(column, names)
    remedy = f"{close} The" if close.startswith("did") else "the"
    raise InputError(
        f"there is no column {column!r}",
        code="missing-column",
        place=place,
        remedy=f"{remedy} columns are {listed(names, 40)}",
    )


def _remedy(text: str, decimal: str) -> str:
    if cell_rules.may_be_grouped(text, decimal):
        other = "," if decimal == "." else "."
        return f"write thousands without separators, or state decimal = {other!r}"
    if "," in text and "." in text:
        return "write the number without thousands separators"
    if decimal == "." and "," in text:
        return "if the comma is the decimal mark, state decimal = ','"
    if decimal == "," and "." in text:
        return "if the point is the decimal mark, state decimal = '.'"
    return "correct it, leave the cell blank if nothing was measured, or exclude the pose"
