"""Datasets from files: which columns are which quantities, in which unit, from which poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, nearest, placed
from loopcal.files.tables import delimited, parquet
from loopcal.files.tables.cells import Cells
from loopcal.files.tables.isolated import read_isolated
from loopcal.files.tables.reader import Layout
from loopcal.files.tables.registry import reader_of, refuse_other_options
from loopcal.files.tables.table import ROW, Table
from loopcal.keys import Key
from loopcal.measurements.dataset import Dataset, checked_every
from loopcal.measurements.poses import asked_ids, positions_of
from loopcal.measurements.source import Source
from loopcal.mechanisms.instruments.camera import PIXEL
from loopcal.units import convertible, difference_to_si, to_si, unit

File = str | Path | BinaryIO
NAMELESS = frozenset(("", "None", "nan"))
"""Ids made of cells without anything in them."""


def read_dataset(
    path: File | Table,
    columns: Mapping[str, ColumnLike] | None = None,
    *,
    pose: str | int | None = None,
    exclude: Iterable[object] = (),
    every: int = 1,
    units: Mapping[str, str] | None = None,
    **layout: Any,
) -> Dataset:
    """Readings from text, XLSX, Parquet, MATLAB or a ROS bag (by the ending of the name).

    A folder is a bag, or is read as its Parquet files one after the other.
    `columns` maps quantity -> column: its name, its number counted from 1 (0 stands for the
    number of the row among those of data), or a mapping with the
    keys of `Column` (column, unit, sd_column, sd_unit, coverage, check). None takes every column of
    numbers under its own name ("column_1" ... without a header). `units` maps quantity -> unit
    where `columns` states none; without a unit values are taken as SI. `pose` is the column of
    ids, else poses are counted "1" to "N". Thinning comes first and counts rows of the file: the
    1st, (every + 1)th, ... is kept; then the ids to `exclude` go. What is left out is not looked
    at otherwise. "-" is standard input, and an open binary stream is read as text; a `Table` was
    read before, by `read_once`.

    How a text is written is recognised: `header` or none, `delimiter`, `decimal` mark,
    `encoding`; each may be stated. `sheet` (name, or number from 1) is for XLSX, `variable` for
    MATLAB, `topic` for bags. Blank, NaN, NA, n/a, #N/A, null, none, failed, - and --- are missing
    readings (NaN).

    Raises InputError, naming file, row and column, for all that cannot be read as stated.
    """
    written = Layout(**layout)
    asked = None if columns is None else specified(columns, units or {})
    step, gone = checked_every(every), asked_ids(exclude)
    if asked is None:
        table = _table(path, written, None)
        asked = all_numeric(table, pose, units or {})
    else:
        table = _table(path, written, wanted(asked, pose), every=step, pose=pose, also=gone)
    refuse_doubles(table, asked)

    number = table.counted - 1
    ids = table.ids(table.position(ROW if pose is None else pose))
    excluded = positions_of(gone, ids, table.name)
    used = number % step == 0
    used[excluded] = False
    source = Source(
        file=table.file,
        part=table.part,
        sha256=table.sha256,
        rows_read=len(number) if table.total is None else table.total,
        excluded=tuple(dict.fromkeys(ids[i] for i in excluded)),
        every=step,
        entry={
            "file": table.file or "-",
            "columns": {q: column.entry() for q, column in asked.items()},
            **({} if pose is None else {"pose": pose}),
            **written.keywords,
        },
    )
    return dataset_of(table, asked, np.flatnonzero(used), ids, source)


def dataset_of(
    table: Table,
    asked: Mapping[str, Column],
    keep: NDArray[np.int64],
    ids: Sequence[str],
    source: Source,
) -> Dataset:
    """The readings of some rows of a table, by position; ids of all its rows.

    source: what is known of the file; its rows and columns are filled in here.
    """

    def values(
        column: str | int, stated_unit: str | None, si: Callable[..., Array] = to_si
    ) -> Array:
        numbers = si(table.numbers(table.position(column), keep), stated_unit or "1")
        numbers.flags.writeable = False  # is kept then, without another copy
        return numbers

    _refuse_nameless(table, keep, ids)
    with_sd = {
        q: (c.sd_column, c.sd_unit or c.unit, c.coverage or 1.0)
        for q, c in asked.items()
        if c.sd_column
    }
    stated = {q: c.unit for q, c in asked.items() if c.unit}
    return Dataset(
        {q: values(c.column, c.unit) for q, c in asked.items()},
        {q: unit(u).si for q, u in stated.items()},
        tuple(ids) if len(keep) == len(ids) else tuple(ids[i] for i in keep.tolist()),
        {q: values(c, u, difference_to_si) / factor for q, (c, u, factor) in with_sd.items()},
        replace(
            source,
            days=table.days(keep),
            rows=table.rows[keep],
            begins=table.begins,
            columns={q: table.label(table.position(c.column)) for q, c in asked.items()},
            sd_columns={q: table.label(table.position(c)) for q, (c, *_) in with_sd.items()},
            stated=stated,
            trusted=frozenset(q for q, c in asked.items() if not c.check),
        ),
    )


def _refuse_nameless(table: Table, keep: NDArray[np.int64], ids: Sequence[str]) -> None:
    """Raise InputError where a pose to keep has no id; ids of all rows."""
    if NAMELESS.isdisjoint(ids):
        return
    nameless = [i for i in keep.tolist() if ids[i] in NAMELESS]
    if nameless:
        raise InputError(
            "this pose has no id"
            + (f", and {len(nameless) - 1} others have none either" if len(nameless) > 1 else ""),
            code="mismatched-poses",
            place=table.place(nameless[0]),
            remedy="fill in the ids, or remove pose = ... to number the poses",
        )


def read_poses(path: File | Table, pose: str | int, **layout: Any) -> Dataset:
    """The ids of the poses of a file, without readings; read as `read_dataset` reads it."""
    table = _table(path, Layout(**layout), None)
    ids = table.ids(table.position(pose))
    _refuse_nameless(table, np.arange(len(ids)), ids)
    source = Source(
        table.file, table.part, table.sha256, len(ids), rows=table.rows, begins=table.begins
    )
    return Dataset({}, {}, tuple(ids), source=source)


def read_table(path: File, **layout: Any) -> Table:
    """All columns of a file as they stand, read as `read_dataset` reads it."""
    return _table(path, Layout(**layout), None)


def read_once(path: File, **layout: Any) -> File | Table:
    """The whole table of a file whose columns are looked at before some of them are read.

    Parquet is read column by column: it stays a path.
    """
    return path if reader_of(path) is parquet.READER else read_table(path, **layout)


def column_labels(path: File | Table, **layout: Any) -> tuple[str, ...]:
    """Names of the columns of a file, read as `read_dataset` reads it; none without a header."""
    if not isinstance(path, Table) and reader_of(path) is parquet.READER:
        return parquet.parquet_files(str(path))[0].names
    stated = Layout(**layout)
    if not isinstance(path, Table) and reader_of(path) is delimited.READER and not stated.spread:
        refuse_other_options(delimited.READER, path, stated)
        return delimited.names_in(path, stated)
    return _table(path, stated, None).names


def _table(
    path: File | Table, layout: Layout, asked: frozenset[str | int] | None, **rows: Any
) -> Table:
    """The columns asked for; rows: which of them to read from Parquet, others are read whole."""
    if isinstance(path, Table):
        return path
    if layout.spread is not None:
        return spread_rows(_table(path, replace(layout, spread=None), None), layout.spread)
    reader = reader_of(path)
    refuse_other_options(reader, path, layout)
    if reader.guarded:
        assert isinstance(path, str | Path)
        return read_isolated(reader, path, layout, wanted=asked)
    return reader.read(path, layout, wanted=asked, **(rows if reader is parquet.READER else {}))


# Which column of a table is which quantity, in which unit, with which sd.


@dataclass(frozen=True)
class Column:
    """Where one quantity stands in a file, and in which unit."""

    column: Annotated[
        str | int,
        Key(
            "Name of the column, its number from 1 (the only way where there is no header), or 0: "
            "the number of the row.",
            alone=True,
        ),
    ]
    unit: Annotated[
        str | None, Key("Unit of the readings; without one SI (m, rad).", is_unit=True)
    ] = None
    sd_column: Annotated[str | int | None, Key("Column with the sd of each reading.")] = None
    sd_unit: Annotated[
        str | None, Key("Unit of the sd; without one, that of the readings.", is_unit=True)
    ] = None
    coverage: Annotated[
        float | None,
        Key(
            "Coverage factor of that column, where it holds an expanded uncertainty: 2 for k = 2. "
            "The sd is the column divided by it.",
            positive=True,
        ),
    ] = None
    check: Annotated[bool, Key("false: the values are right though strange.")] = True

    def entry(self) -> dict[str, Any]:
        """As a project states it."""
        return {key: value for key, value in asdict(self).items() if value is not None}


ColumnLike = str | int | Mapping[str, Any] | Column


def specified(columns: Mapping[str, ColumnLike], units: Mapping[str, str]) -> dict[str, Column]:
    """Quantity -> its column, with the unit from `units` where the column states none.

    Raises InputError for an unknown key or unit, and for two units of one quantity. Raises it
    also for a unit of a quantity that is absent, and for an sd in a unit of another dimension.
    """
    if not columns:
        raise InputError(
            "no column is requested",
            code="missing-column",
            remedy="map at least one quantity to a column",
        )
    for quantity in units:
        if quantity not in columns:
            raise InputError(
                f"a unit is given for {quantity!r}, which has no column",
                code="conflicting-keys",
                remedy=nearest(quantity, columns),
            )
    return {q: _checked(q, _column(q, stated), units.get(q)) for q, stated in columns.items()}


def wanted(columns: Mapping[str, Column], pose: str | int | None) -> frozenset[str | int]:
    """All columns that have to be read."""
    named = [c.column for c in columns.values()] + [c.sd_column for c in columns.values()]
    return frozenset(column for column in [*named, pose] if column not in (None, ROW))


def all_numeric(
    table: Table, pose: str | int | None, units: Mapping[str, str]
) -> dict[str, Column]:
    """Every column of numbers but the ids, under its own name, else "column_1", "column_2", ..."""
    aside = None if pose is None else table.position(pose)
    columns: dict[str, ColumnLike] = {}
    for i in table.numeric():
        if i != aside:
            name = table.names[i] if table.names else ""
            columns[name or f"column_{i + 1}"] = name or i + 1
    if not columns:
        raise InputError(
            "there is no column of numbers",
            code="missing-column",
            place=table.name,
            remedy="check the delimiter and the decimal mark, or name the columns to read",
        )
    return specified(columns, units)


def refuse_doubles(table: Table, columns: Mapping[str, Column]) -> None:
    """Raise InputError where two quantities, or a reading and an sd, stand in one column."""
    user: dict[int, str] = {}
    for quantity, column in columns.items():
        other = user.setdefault(table.position(column.column), quantity)
        if other != quantity:
            raise InputError(
                f"column {column.column!r} is mapped twice: to {other!r} and {quantity!r}",
                code="duplicate-column",
                place=table.name,
                remedy="map each quantity to a different column",
            )
    for quantity, column in columns.items():
        reads = column.sd_column is not None and user.get(table.position(column.sd_column))
        if reads:
            raise InputError(
                f"column {column.sd_column!r} is mapped as the readings of {reads!r} and as the "
                f"sd of {quantity!r}",
                code="duplicate-column",
                place=table.name,
                remedy="name the column that holds the sd",
            )


def _column(quantity: str, stated: ColumnLike) -> Column:
    if isinstance(stated, Column | str):
        return Column(stated) if isinstance(stated, str) else stated
    # As a project's file is read; only that needs pydantic.
    from loopcal.files.toml.place import NOTHING, Place
    from loopcal.files.toml.tables import built, read_tables

    place = Place(f"column of {quantity!r}")
    entry = dict(stated) if isinstance(stated, Mapping) else {"column": stated}
    column: Column = built(Column, read_tables(Column, entry, place).entry, NOTHING, place)
    return column


def _checked(quantity: str, column: Column, other_unit: str | None) -> Column:
    place = f"column of {quantity!r}"
    if other_unit and column.unit and unit(other_unit) != unit(column.unit):
        raise InputError(
            f"two units are stated, {column.unit} and {other_unit}",
            code="wrong-unit",
            place=place,
            remedy="state one of them",
        )
    readings_unit = column.unit or other_unit
    with placed(place):
        sd_unit = column.sd_unit or readings_unit
        fits = not (readings_unit and sd_unit) or convertible(readings_unit, sd_unit)
        for name in (readings_unit, sd_unit):
            if name:
                unit(name)
    if not fits:
        raise InputError(
            f"the sd is in {sd_unit}, the readings in {readings_unit}",
            code="wrong-unit",
            place=place,
            remedy=f"give the sd in a unit of {unit(readings_unit or '1').dimension}",
        )
    if column.coverage is not None and not (column.sd_column and column.coverage > 0):
        raise InputError(
            f"coverage is {column.coverage}"
            + ("" if column.sd_column else ", and no column of sds is named"),
            code="invalid-value" if column.sd_column else "conflicting-keys",
            place=place,
            remedy='name sd_column = "...", and give coverage = 2 where it holds two sds',
        )
    return replace(column, unit=readings_unit)


# Tables with one row for each point of an image, spread to one row for each pose.
#
#     pose, camera, board, point, u, v        pose, 1:board:0:u, 1:board:0:v, 1:board:1:u, ...
#
# The labels of a row make the name of its readings; a point that was not seen is missing.


Index = NDArray[np.intp]
LABELS = ("camera", "board", "point")
MOST = 1 << 26
"""Cells of the table that is made: half a gigabyte."""


def spread_rows(table: Table, columns: Mapping[str, str]) -> Table:
    """A table of corners as one with a row for each pose.

    columns: the names of its columns of pose, labels, u and v.

    Raises InputError for a point that stands twice in one pose, and for a table that would be
    too large.
    """
    pose = table.ids(table.position(columns["pose"]))
    labels = [table.labels(table.position(columns[key])) for key in LABELS if key in columns]
    named = [":".join(row) for row in zip(*labels, strict=True)]
    poses, names = list(dict.fromkeys(pose)), list(dict.fromkeys(named))
    if len(poses) * len(names) * len(PIXEL) > MOST:
        raise InputError(
            f"{len(poses)} poses with {len(names)} different points are too large a table",
            code="too-large",
            place=table.name,
            remedy="check the columns of pose and point; give fewer poses",
        )
    row = {name: i for i, name in enumerate(poses)}
    place = {name: i for i, name in enumerate(names)}
    rows = np.array([row[name] for name in pose], dtype=np.intp)
    points = np.array([place[name] for name in named], dtype=np.intp)
    _refuse_repeated(table, rows, points, named, pose)
    cells: dict[int, Cells] = {0: poses}
    headers = [columns["pose"]]
    keep = np.arange(len(pose), dtype=np.int64)
    wide = []
    for axis in PIXEL:
        filled = np.full((len(names), len(poses)), np.nan)
        filled[points, rows] = table.numbers(table.position(columns[axis]), keep)
        wide.append(filled)
    for name, *values in zip(names, *wide, strict=True):
        for axis, value in zip(PIXEL, values, strict=True):
            cells[len(headers)] = value
            headers.append(f"{name}:{axis}")
    first = np.full(len(poses), -1, dtype=np.int64)
    first[rows[::-1]] = table.rows[::-1]
    return Table(table.file, table.part, table.sha256, tuple(headers), cells, first, decimal=".")


def _refuse_repeated(
    table: Table, rows: Index, points: Index, named: list[str], pose: tuple[str, ...]
) -> None:
    code = rows * (int(points.max(initial=0)) + 1) + points
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    if (count > 1).any():
        index = int(first[count > 1][0])
        again = int(np.flatnonzero(code == code[index])[1])
        raise InputError(
            f"the point {named[index]} stands twice in pose {pose[index]}",
            code="duplicate-name",
            place=table.place(again),
            remedy="keep one of them",
        )
