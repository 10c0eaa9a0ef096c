"""Columns of one or several tables side by side: a row per pose, joined by ids or by row order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed
from loopcal.files.recognition.headers import Heading, heading, stem
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.poses import pose_id
from loopcal.measurements.tables import column, column_names

Array = NDArray[np.float64]
_IDS = frozenset(
    (
        *("pose", "poses", "pose_id", "poseid", "pose_no", "pose_nr", "pose_number", "id", "ids"),
        *("no", "nr", "number", "num", "index", "idx", "point", "point_id", "sample", "n", "i"),
        *("measurement", "name", "config", "configuration", "row", "label", "punkt", "messung"),
    )
)
TIMES = frozenset(("time", "timestamp", "t", "zeit", "date", "datetime", "seconds"))


STILL = 1e-3
"""An axis whose readings span so much less than another's stands still."""


@dataclass(frozen=True, eq=False)
class Field:
    """A column of numbers, its rows those of the joined poses.

    table: number of its table; position: where it stands there, from 0; heading: None where the
    table has no header.
    """

    table: int
    position: int
    heading: Heading | None
    values: Array

    @property
    def stem(self) -> str:
        """Its name in lower case; empty where it has none."""
        return self.heading.stem if self.heading else ""

    @property
    def unit(self) -> str | None:
        """The unit that its header states."""
        return self.heading.unit if self.heading else None

    @property
    def label(self) -> str:
        """How the reader knows it: its header, or its number."""
        return self.heading.text if self.heading else f"column {self.position + 1}"

    @property
    def span(self) -> float:
        """Largest minus smallest value."""
        known = self.values[np.isfinite(self.values)]
        return float(np.ptp(known)) if known.size else 0.0

    def resolution(self) -> float:
        """The step to which its values were rounded, a power of ten; 0 where there is none."""
        known = self.values[np.isfinite(self.values)]
        largest = np.abs(known).max(initial=0.0)
        for digits in range(-3, 10):
            scaled = known * 10.0**digits
            close = 1e-9 * max(largest * 10.0**digits, 1e3)
            if (
                np.abs(scaled).max(initial=0.0) >= 1.0
                and (abs(scaled - scaled.round()) < close).all()
            ):
                return 10.0**-digits
        return 0.0


@dataclass(frozen=True, eq=False)
class Source:
    """A table as it was given.

    path: of its file, None for a table in memory; sheet: of a workbook; ids: one per row, None
    where no column holds them; pose: that column's name or number; fields: its columns of numbers;
    names: its header.
    """

    path: Path | None
    sheet: str | None
    fields: tuple[Field, ...]
    ids: tuple[str, ...] | None
    pose: str | int | None
    names: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.path.name if self.path else f"table {self.fields[0].table + 1}"

    def __len__(self) -> int:
        return len(self.fields[0].values)


@dataclass(frozen=True, eq=False)
class Fields:
    """All columns of all tables, a row per pose.

    by_order: whether rows of several tables were joined by their order; remarks: what was
    understood, for the reader.
    """

    sources: tuple[Source, ...]
    poses: tuple[str, ...]
    fields: tuple[Field, ...]
    by_order: bool = False
    remarks: tuple[str, ...] = field(default=())


def source_of(given: Any, number: int) -> Source:
    """A file by its path, or a Dataset, dict of arrays or DataFrame.

    Raises InputError for a table without a column of numbers.
    """
    if isinstance(given, str | Path):
        return _of_file(Path(given), number)
    if isinstance(given, Dataset):
        fields = [
            Field(number, i, Heading(q, stem(q), given.units.get(q)), values)
            for i, (q, values) in enumerate(given.readings.items())
        ]
        for quantity, sds in given.sds.items():
            its = Heading(f"{quantity} sd", f"{stem(quantity)}_sd", given.units.get(quantity))
            fields.append(Field(number, len(fields), its, sds))
        return _checked(Source(None, None, tuple(fields), given.poses, "pose"))
    fields, ids, pose = [], None, None
    for i, name in enumerate(column_names(given)):
        values = np.asarray(column(given, name))
        its = heading(name)
        if ids is None and its.stem in _IDS and len(set(values.tolist())) == len(values):
            ids, pose = tuple(map(pose_id, values.tolist())), name
        elif values.dtype.kind in "fiu":
            fields.append(Field(number, i, its, values.astype(np.float64)))
    return _checked(Source(None, None, tuple(fields), ids, pose))


def joined(sources: Sequence[Source]) -> Fields:
    """The tables side by side: by pose ids where all have them, else by row order.

    Raises InputError where neither is possible.
    """
    first = sources[0]
    if len(sources) == 1:
        poses = first.ids or tuple(str(i) for i in range(1, len(first) + 1))
        return Fields(tuple(sources), poses, first.fields)
    if all(s.ids is not None for s in sources):
        others = [set(s.ids or ()) for s in sources[1:]]
        common = [i for i in first.ids or () if all(i in ids for ids in others)]
        if common:
            return _by_ids(sources, common)
    lengths = {s.name: len(s) for s in sources}
    if len({len(s) for s in sources}) > 1:
        counts = ", ".join(f"{name} has {length} rows" for name, length in lengths.items())
        raise InputError(
            f"the files cannot be joined: {counts}, and they share no column of pose ids",
            code="mismatched-poses",
            remedy='give each file a column "pose" with the same ids',
        )
    poses = tuple(str(i) for i in range(1, len(first) + 1))
    fields = tuple(f for s in sources for f in s.fields)
    told = f"{' and '.join(lengths)} share no pose ids: their rows are joined by order"
    return Fields(tuple(sources), poses, fields, True, (told,))


def _by_ids(sources: Sequence[Source], common: Sequence[str]) -> Fields:
    fields = []
    for source in sources:
        where = {pose: i for i, pose in enumerate(source.ids or ())}
        rows = np.array([where[pose] for pose in common], dtype=np.intp)
        fields += [Field(f.table, f.position, f.heading, f.values[rows]) for f in source.fields]
    told = [f"the files are joined by pose ids: {len(common)} poses are in all of them"]
    for source in sources:
        if len(source) > len(common):
            told.append(f"{source.name}: {len(source) - len(common)} poses are not in every file")
    return Fields(tuple(sources), tuple(common), tuple(fields), False, tuple(told))


def _of_file(path: Path, number: int) -> Source:
    table = read_table(path)
    numeric = table.numeric()
    names = [table.names[i] if i < len(table.names) else "" for i in range(_width(table))]
    headings = [heading(name) if name else None for name in names]
    units = _row_of_units(table, numeric)
    every = np.arange(1 if units else 0, len(table.rows))
    for i, its in units.items():
        headings[i] = replace(headings[i] or Heading("", ""), unit=its or None)
    pose = _pose_column(table, headings, numeric)
    fields = tuple(
        Field(number, i, headings[i] if i < len(headings) else None, table.numbers(i, every))
        for i in numeric
        if i != pose
    )
    ids = None if pose is None else tuple(table.ids(pose)[i] for i in every)
    sheet = table.sheet
    named = None if pose is None else column_key(names, pose)
    # a row of units is no row of readings: what is below it is written into a file of its own
    return _checked(Source(None if units else path, sheet, fields, ids, named, tuple(names)))


def _row_of_units(table: Table, numeric: Sequence[int]) -> dict[int, str]:
    """Position -> unit, of the first row below a header if it holds units; else empty."""
    if not table.names or len(table.rows) < 2:
        return {}
    found = {}
    for i in numeric:
        text = table.first(i)
        if text is None:
            return {}
        found[i] = heading(f"x [{text}]").unit or ""
    return found if any(found.values()) else {}


def column_key(names: Sequence[str], position: int) -> str | int:
    """How a project names a column: by its name, by its number where that would be ambiguous."""
    name = names[position] if position < len(names) else ""
    return name if name and list(names).count(name) == 1 else position + 1


def _width(table: Table) -> int:
    return max(len(table.names), 1 + max(table.columns, default=-1))


def _pose_column(
    table: Table, headings: Sequence[Heading | None], numeric: Sequence[int]
) -> int | None:
    """The column of ids: by its name, or a count that begins a table without a header."""
    for i in table.columns:
        its = headings[i] if i < len(headings) else None
        if its is not None and its.stem in _IDS:
            ids = table.ids(i)
            if len(set(ids)) == len(ids) > 1:
                return i
    if not table.names and numeric and numeric[0] == 0:
        first = table.numbers(0, np.arange(len(table.rows)))
        steps = np.diff(first)
        if first.size > 3 and (steps == 1.0).all() and (first == np.round(first)).all():
            return 0
    return None


def _checked(source: Source) -> Source:
    if not source.fields:
        raise InputError(
            "there is no column of numbers",
            code="missing-column",
            place=source.name,
            remedy="give a table with a row per pose and a column per reading",
        )
    return source


def moving(fields: Sequence[Field]) -> tuple[Field, ...]:
    """Those that do not stand still beside the others."""
    most = max((f.span for f in fields), default=0.0)
    return tuple(f for f in fields if f.span > STILL * most)


def names_of(fields: Sequence[Field]) -> str:
    """Columns as the reader knows them."""
    return ", ".join(f.label for f in fields)


def unnamed(fields: Sequence[Field]) -> str:
    """Columns listed for a message."""
    return listed([f.label for f in fields], 40)
