"""Datasets from files: which columns are which quantities, in which unit, from which poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.tables import delimited, parquet
from loopcal.files.tables.columns import (
    Column,
    ColumnLike,
    all_numeric,
    refuse_doubles,
    specified,
    wanted,
)
from loopcal.files.tables.isolated import read_isolated
from loopcal.files.tables.reader import Layout
from loopcal.files.tables.registry import reader_of, refuse_other_options
from loopcal.files.tables.spread import spread_rows
from loopcal.files.tables.table import ROW, Table
from loopcal.measurements.dataset import Dataset, checked_every
from loopcal.measurements.poses import asked_ids, positions_of
from loopcal.measurements.source import Source
from loopcal.units import difference_to_si, to_si, unit

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
