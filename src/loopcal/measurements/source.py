"""Where readings came from, so that messages about a value name its file and row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.days import Days


@dataclass(frozen=True, eq=False)
class Source:
    """File, rows and columns behind a dataset; all empty where arrays were given in memory."""

    file: str | None = None
    """Name of the file ("-" for standard input)."""
    part: str | None = None
    """Sheet or variable, of a file that may hold several."""
    sha256: str | None = None
    """Of the bytes of the file."""
    rows_read: int = 0
    """Poses that were there before any was left out."""
    excluded: tuple[str, ...] = ()
    """Ids of poses left out on request."""
    copied: tuple[str, ...] = ()
    """Ids of poses left out because their rows copy others."""
    agreeing: tuple[str, ...] = ()
    """Ids of poses whose rows equal others, as rows of such coarse readings may by chance."""
    averaged: tuple[str, ...] = ()
    """Ids of repeats of an earlier pose, which counts with their mean."""
    discarded: tuple[str, ...] = ()
    """Ids of poses left out because they do not fit the others."""
    judged: bool = False
    """Whether no copies are to be sought: they are known, or poses were taken several times."""
    every: int = 1
    """Thinning: the 1st, (every + 1)th, ... row was kept."""
    days: Days | None = None
    """Of the measurement, by a column of dates."""
    read_as: str = ""
    """What was made of columns that are not those of the first files, in words."""
    rows: NDArray[np.int64] | None = None
    """(N,) row of each pose in the file, counted from 1 as an editor or a spreadsheet does."""
    begins: Mapping[str, int] = field(default_factory=dict)
    """Of a folder: file -> rows in the files before it; `rows` count through all of them."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> name (or number) of its column in the file."""
    sd_columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> name (or number) of the column of its sd."""
    stated: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> unit as stated where the data came in; absent: taken as SI."""
    trusted: frozenset[str] = frozenset()
    """Quantities whose values the user vouches for (`check = false`)."""
    entry: Mapping[str, Any] = field(default_factory=dict)
    """How they were read, as the table [data] of a project states it: `file`, `columns` (quantity
    -> its `column`, `unit` ...), `pose`, the layout; empty: columns named as quantities, in SI."""
    joined: tuple[Source, ...] = ()
    """Further files, of the same poses or others; rows are 0 where a file has no such pose."""

    @property
    def name(self) -> str | None:
        """How messages call the file; None where there is none."""
        return None if self.file is None else file_name(self.file, self.part)

    @property
    def measured(self) -> Days | None:
        """The days of the measurement over all files that hold dates; None where none does."""
        days = [part.days for part in (self, *self.joined) if part.days is not None]
        if not days:
            return None
        return Days(min(one.first for one in days), max(one.last for one in days))

    def take(self, index: NDArray[np.int64]) -> Source:
        """The source of those poses alone."""
        rows = None if self.rows is None else self.rows[index]
        judged = self.judged or len(np.unique(index)) < len(index)
        joined = tuple(part.take(index) for part in self.joined)
        return replace(self, rows=rows, joined=joined, judged=judged)

    def place(self, index: int, pose: str, quantity: str | None = None, *, sd: bool = False) -> str:
        """How messages call one value: "left.csv, row 14, column 'S'", or its pose and quantity."""
        for part in self.joined:
            if quantity is not None and quantity in part.columns:
                return part.place(index, pose, quantity, sd=sd)
        words = [self.name] if self.name else []
        row = 0 if self.rows is None else int(self.rows[index])
        words.append(row_name(row, self.begins) if row else f"pose {pose!r}")
        column = (self.sd_columns if sd else self.columns).get(quantity or "")
        if column is not None:
            words.append(f"column {column!r}")
        elif quantity is not None:
            words.append(f"sd of {quantity!r}" if sd else f"quantity {quantity!r}")
        return ", ".join(words)


def row_name(row: int, begins: Mapping[str, int]) -> str:
    """How messages call a row; in a folder by its file, and its row there.

    >>> row_name(25, {"a.parquet": 0, "b.parquet": 20})
    'b.parquet, row 5'
    """
    for file, begin in reversed([*begins.items()]):
        if row > begin:
            return f"{file}, row {row - begin}"
    return f"row {row}"


def file_name(file: str, part: str | None = None) -> str:
    """How messages call a file and the part of it that was read."""
    name = "standard input" if file == "-" else file
    return f"{name}, {part}" if part else name
