"""Readings as a table of the kind that a project reads: its column names, its units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.project.data_table import DataTable, FileTable
from loopcal.files.tables.table import ROW
from loopcal.files.tables.writer import Column, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.units import difference_from_si, from_si


def readings_tables(
    dataset: Dataset,
    spec: DataTable | None,
    sds: Mapping[str, Array],
    out: Path,
    more: Mapping[str, Column] | None = None,
) -> dict[str, bytes]:
    """Tables of readings (.csv, .tsv, .parquet) by file name, blank where nothing was read.

    spec: how the project reads its data, None for quantities under their own names in SI. A
    column that it knows by number gets the quantity's name. Files that it joins get the names
    they have there, beside `out`. sds: quantity -> (N,) [SI], for the columns of sds it asks for.

    more: further columns of the first file.

    Raises InputError for a joined file whose columns are not stated.
    """
    joins = spec.join if spec else ()
    elsewhere = {q for part in joins for q in part.columns}
    quantities = [q for q in dataset.readings if q not in elsewhere]
    columns = {**_columns(dataset, quantities, spec, sds), **(more or {})}
    tables = {out.name: table_bytes(columns, out.suffix)}
    for part in joins:
        joined_quantities = [q for q in part.columns if q in dataset.readings]
        name = Path(part.file).name
        if not (part.columns or part.instrument):
            raise InputError(
                f"no columns are named for {name}",
                code="missing-key",
                remedy="name its columns in the project: columns = { x = ... }",
            )
        if joined_quantities or part.instrument:
            tables[name] = table_bytes(
                _columns(dataset, joined_quantities, part, sds), Path(name).suffix
            )
    return tables


def _columns(
    dataset: Dataset, quantities: Sequence[str], spec: FileTable | None, sds: Mapping[str, Array]
) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    pose = spec.pose if spec else None
    columns[pose if isinstance(pose, str) else "pose"] = dataset.poses
    for quantity in quantities:
        readings = dataset.readings[quantity]
        column = spec.columns.get(quantity) if spec else None
        if column and column.column == ROW:
            raise InputError(
                f"{quantity!r} is read from the row number, which cannot be simulated",
                code="conflicting-keys",
                remedy="name a column for it",
            )
        name = column.column if column and isinstance(column.column, str) else quantity
        stated = column.unit if column else None
        if column is None and spec is not None:
            stated = spec.column(quantity, dataset.units.get(quantity, "1")).unit
        column_unit = stated or "1"
        columns[name] = from_si(readings, column_unit)
        if column and isinstance(column.sd_column, str) and quantity in sds:
            # An sd of inf means not measured, which a table states by a blank cell.
            sd = np.where(np.isfinite(sds[quantity]), sds[quantity], np.nan)
            sd = difference_from_si(sd, column.sd_unit or column_unit)
            columns[column.sd_column] = sd * (column.coverage or 1.0)
    return columns
