"""A table as it was given: its columns of numbers with their headings, and the ids of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, short
from loopcal.files.recognition.headers import Heading, heading, stem
from loopcal.files.recognition.titles import below_titles, readings_of
from loopcal.files.tables.table import Table
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.poses import pose_id
from loopcal.measurements.tables import as_numbers, column, column_names

Array = NDArray[np.float64]
_IDS = frozenset(
    (
        *(
            "poloha",
            "bod",
            "mereni",
            "cislo",
            "numero",
            "punto",
            "posicion",
            "punkt_nr",
            "posizione",
        ),
        *("pose", "poses", "pose_id", "poseid", "pose_no", "pose_nr", "pose_number", "id", "ids"),
        *("no", "nr", "number", "num", "index", "idx", "point", "point_id", "sample", "n", "i"),
        *("measurement", "name", "config", "configuration", "row", "label", "punkt", "messung"),
    )
)
STATIONS = frozenset(
    (
        *("sta", "stn", "station", "stations", "station_id", "station_no", "station_nr", "setup"),
        *("tracker_station", "instrument_station", "standpunkt", "aufstellung", "stationierung"),
        *("stanoviste", "stanovisko", "stationnement", "estacion", "stazione"),
    )
)
_TARGETS = frozenset(
    (
        *("target", "reflector", "smr", "prism", "ball", "marker", "target_id", "reflector_id"),
        *("reflektor", "prisma", "zielmarke", "odrazec", "cil", "cible", "reflecteur"),
    )
)
TIMES = frozenset(("time", "timestamp", "t", "zeit", "date", "datetime", "seconds"))


_WORKBOOKS = (".xlsx", ".xlsm")
_CLEARLY = 3
"""A sheet with so many times the numbers of any other holds the readings."""
_MOST_TARGETS = 8
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

    path: of its file, None for a table in memory; sheet: of a workbook, or the variable of a MATLAB
    file that was asked for; ids: one per row, None where no column holds them; pose: that column's
    name or number; fields: its columns of numbers; names: its header; label: how messages call it
    without a path; remark: what was decided in reading it.
    """

    path: Path | None
    sheet: str | None
    fields: tuple[Field, ...]
    ids: tuple[str, ...] | None
    pose: str | int | None
    names: tuple[str, ...] = ()
    label: str = ""
    remark: str = ""

    @property
    def name(self) -> str:
        """How messages call it."""
        number = self.fields[0].table + 1 if self.fields else 1
        return self.path.name if self.path else self.label or f"table {number}"

    def __len__(self) -> int:
        return len(self.fields[0].values)


def source_of(given: Any, number: int, sheet: str | None = None) -> Source:
    """A file by its path, or a Dataset, dict of arrays or DataFrame.

    sheet: of workbooks, or the variable of MATLAB files. Raises InputError for a table without a
    column of numbers, and for a workbook of which several sheets may hold the readings.
    """
    if isinstance(given, str | Path):
        return _of_file(Path(given), number, sheet if _parted(Path(given)) else None)
    if isinstance(given, Dataset):
        fields = [
            Field(number, i, Heading(q, stem(q), given.units.get(q)), values)
            for i, (q, values) in enumerate(given.readings.items())
        ]
        for quantity, sds in given.sds.items():
            its = Heading(f"{quantity} sd", f"{stem(quantity)}_sd", given.units.get(quantity))
            fields.append(Field(number, len(fields), its, sds))
        return _checked(Source(None, None, tuple(fields), given.poses, "pose"))
    fields, ids, pose, texts = [], None, None, dict[str, tuple[str, ...]]()
    for i, name in enumerate(column_names(given)):
        values = column(given, name)
        its = heading(name)
        if its.stem in _IDS:
            found = tuple(map(pose_id, np.asarray(values).tolist()))
            if ids is None or len(set(ids)) < len(set(found)) == len(found):
                ids, pose = found, name
                continue
        try:
            fields.append(Field(number, i, its, as_numbers(values, name)))
        except InputError:  # text, dates: no readings
            told = tuple(map(str, np.asarray(values).tolist()))
            if its.stem in STATIONS:
                fields.append(Field(number, i, its, _counted(told)))
            else:
                texts[its.stem] = told
    return _with_ids(Source(None, None, tuple(fields), ids, pose), texts)


def _parted(path: Path) -> bool:
    return path.suffix.lower() in (*_WORKBOOKS, ".mat")


def _of_file(path: Path, number: int, sheet: str | None) -> Source:
    table, remark, titled = _table_of(path, sheet)
    numeric = table.numeric()
    names = [table.names[i] if i < len(table.names) else "" for i in range(_width(table))]
    headings = [heading(name) if name else None for name in names]
    units = _row_of_units(table, numeric)
    for i, its in units.items():
        headings[i] = replace(headings[i] or Heading("", ""), unit=its or None)
    pose = _pose_column(table, headings, numeric)
    texts = [i for i in table.columns if i not in numeric and i != pose]
    cells = {i: table.ids(i) for i in (pose, *texts) if i is not None}
    beginning = [table.ids(i) for i in sorted(table.columns)[:1]]
    count = len(table.rows)
    every = readings_of([*cells.values(), *beginning], count)
    if len(every) < count:
        rows = count - len(every)
        last = "The last row" if rows == 1 else f"The last {rows} rows"
        told_so = f"{last} of {table.name}: a summary of the others, left out."
        remark = f"{remark} {told_so}".strip()
    every = every[1 if units else 0 :]
    told = {i: tuple(its[k] for k in every) for i, its in cells.items()}
    values = {i: table.numbers(i, every) for i in numeric if i != pose}
    values |= {i: _counted(told[i]) for i in texts if _stem(headings, i) in STATIONS}
    fields = tuple(
        Field(number, i, headings[i] if i < len(headings) else None, values[i])
        for i in sorted(values)
    )
    ids = None if pose is None else told[pose]
    sheet = table.sheet if path.suffix.lower() in _WORKBOOKS else sheet
    named = None if pose is None else column_key(names, pose)
    # what is not one table below its header is written into a file of its own
    header = tuple(names)
    place = path if len(every) == count and not titled else None
    source = Source(place, sheet, fields, ids, named, header, path.name, remark)
    return _with_ids(source, {_stem(headings, i): told[i] for i in texts if i not in values})


def _counted(names: Sequence[str]) -> Array:
    """(N,) numbers from 1 for names, in the order in which they occur; NaN for an empty cell."""
    order = list(dict.fromkeys(name for name in names if name))
    return np.array([1.0 + order.index(name) if name else np.nan for name in names])


def _table_of(path: Path, sheet: str | None) -> tuple[Table, str, bool]:
    """The table of a file, what to say of the choice, and whether titles stand above its header;
    of a workbook the sheet with by far the most numbers."""
    if sheet is not None or path.suffix.lower() not in _WORKBOOKS:
        table, title = below_titles(path, sheet)
        return table, title, bool(title)
    found: list[tuple[Table, str]] = []
    first: InputError | None = None
    for number in count(1):
        try:
            table, title = below_titles(path, number)
        except InputError as error:
            # there is no sheet of this number, or the fault is that of the file, not of a sheet
            if error.code == "unknown-name" or (first and str(error) == str(first)):
                break
            first = first or error
            continue
        if len(table.numeric()) > 1 and len(table.rows) > 1:
            found.append((table, title))
    if not found:
        raise first or _no_numbers(path.name)
    found.sort(key=lambda its: _numbers(its[0]), reverse=True)
    (best, title), *others = found
    if not others:
        return best, title, bool(title)
    which = ", ".join(f"{short(str(one.sheet))!r} ({len(one.rows)} rows)" for one, _ in found[:10])
    if _numbers(best) < _CLEARLY * _numbers(others[0][0]):
        raise InputError(
            f"several sheets may hold the readings: {which}",
            code="missing-key",
            place=path.name,
            remedy=f"name one: --sheet {best.sheet!r}",
        )
    remark = f"{path.name} has several sheets: {which}; the first is read."
    return best, f"{remark} {title}".strip(), bool(title)


def _numbers(table: Table) -> int:
    return len(table.rows) * len(table.numeric())


def _with_ids(source: Source, texts: Mapping[str, tuple[str, ...]]) -> Source:
    """With ids that occur once: a row per target, or per station, becomes a row per pose; other
    repeated ids are no ids. texts: columns of text by name."""
    checked = _checked(source)
    ids = checked.ids
    if ids is None or len(set(ids)) == len(ids):
        return checked
    numbers = {
        f.stem: tuple(map(str, f.values)) for f in checked.fields if f.stem in _TARGETS | STATIONS
    }
    labels = {**texts, **numbers}
    for stem_ in sorted(labels, key=lambda word: (word not in _TARGETS, word in STATIONS)):
        rest = tuple(f for f in checked.fields if f.stem != stem_ or stem_ not in numbers)
        wide = _widened(rest, ids, labels[stem_])
        if wide is not None:
            return Source(None, None, wide, tuple(dict.fromkeys(ids)), "pose", label=checked.name)
    return replace(checked, ids=None, pose=None)


def _widened(
    fields: Sequence[Field], ids: Sequence[str], labels: Sequence[str]
) -> tuple[Field, ...] | None:
    """Columns with a row per id; what differs between labels has a column for each of them.

    None where an id has a label twice, or the labels are not few.
    """
    kinds, poses = list(dict.fromkeys(labels)), list(dict.fromkeys(ids))
    if not 1 < len(kinds) <= _MOST_TARGETS or len(set(zip(ids, labels, strict=True))) < len(ids):
        return None
    rows = np.array([poses.index(i) for i in ids]), np.array([kinds.index(k) for k in labels])
    found: list[Field] = []
    for field in fields:
        cells = np.full((len(poses), len(kinds)), np.nan)
        cells[rows] = field.values
        low = np.nan_to_num(cells, nan=np.inf).min(axis=1)
        high = np.nan_to_num(cells, nan=-np.inf).max(axis=1)
        read = high >= low
        if ((high - low)[read] <= STILL * field.span).all():
            found.append(replace(field, values=np.where(read, low, np.nan)))
            continue
        its = field.heading or Heading("", f"column_{field.position + 1}")
        for k, kind in enumerate(kinds):
            named = Heading(f"{its.text} of {kind}".strip(), f"{its.stem}_{k + 1}", its.unit)
            found.append(Field(field.table, field.position, named, cells[:, k]))
    return tuple(found)


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
    named = [i for i in table.columns if _stem(headings, i) in _IDS]
    for once in (True, False):
        for i in named:
            ids = table.ids(i)
            if len(ids) > 1 and (len(set(ids)) == len(ids) or (not once and i not in numeric)):
                return i
    if not table.names and numeric and numeric[0] == 0:
        first = table.numbers(0, np.arange(len(table.rows)))
        steps = np.diff(first)
        if first.size > 3 and (steps == 1.0).all() and (first == np.round(first)).all():
            return 0
    return None


def _stem(headings: Sequence[Heading | None], i: int) -> str:
    its = headings[i] if i < len(headings) else None
    return its.stem if its else ""


def _checked(source: Source) -> Source:
    if not source.fields:
        raise _no_numbers(source.name)
    return source


def _no_numbers(name: str) -> InputError:
    return InputError(
        "there is no column of numbers",
        code="missing-column",
        place=name,
        remedy="give a table with a row per pose and a column per reading",
    )


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
