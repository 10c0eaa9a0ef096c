"""Readings as a table of the kind that a project reads: its column names, its units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.project.data_entries import DataSpec
from loopcal.files.tables.table import ROW
from loopcal.files.tables.writer import Column, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.units import difference_from_si, from_si, unit

Array = NDArray[np.float64]


def readings_tables(
    dataset: Dataset,
    spec: DataSpec | None,
    sds: Mapping[str, Array],
    out: Path,
    more: Mapping[str, Column] | None = None,
) -> dict[str, bytes]:
    """Tables of readings (.csv, .tsv, .parquet) by file name, blank where nothing was read.

    spec: how the project reads its data, None for quantities under their own names in SI; a
    column that it knows by number gets the quantity's name. Files that it joins get the names
    they have there, beside `out`. sds: quantity -> (N,) [SI], for the columns of sds it asks for.

    more: further columns of the first file.

    Raises InputError for a joined file whose columns are not stated.
    """
    joins = spec.joins if spec else ()
    elsewhere = {q for part in joins for q in part.columns}
    own = [q for q in dataset.readings if q not in elsewhere]
    columns = {**_columns(dataset, own, spec, sds), **(more or {})}
    tables = {out.name: table_bytes(columns, out.suffix)}
    for part in joins:
        its = [q for q in part.columns if q in dataset.readings]
        name = Path(part.file).name
        if not (part.columns or part.instruments):
            raise InputError(
                f"no columns are named for {name}",
                code="missing-key",
                remedy="name its columns in the project: columns = { x = ... }",
            )
        if its or part.instruments:
            tables[name] = table_bytes(_columns(dataset, its, part, sds), Path(name).suffix)
    return tables


def _columns(
    dataset: Dataset, quantities: Sequence[str], spec: DataSpec | None, sds: Mapping[str, Array]
) -> dict[str, Column]:
    options = spec.options if spec else {}
    columns: dict[str, Column] = {}
    pose = options.get("pose")
    columns[pose if isinstance(pose, str) else "pose"] = dataset.poses
    for quantity in quantities:
        readings = dataset.readings[quantity]
        its = spec.columns.get(quantity) if spec else None
        if its and its.column == ROW:
            raise InputError(
                f"{quantity!r} is read from the row number, which cannot be simulated",
                code="conflicting-keys",
                remedy="name a column for it",
            )
        name = its.column if its and isinstance(its.column, str) else quantity
        stated = its.unit if its else None
        if its is None and spec is not None:
            stated = spec.file_units.get(unit(dataset.units.get(quantity, "1")).dimension)
        its_unit = stated or "1"
        columns[name] = from_si(readings, its_unit)
        if its and isinstance(its.sd_column, str) and quantity in sds:
            sd = np.where(np.isfinite(sds[quantity]), sds[quantity], np.nan)
            sd = difference_from_si(sd, its.sd_unit or its_unit)
            columns[its.sd_column] = sd * (its.coverage or 1.0)
    return columns
