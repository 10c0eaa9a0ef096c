"""Readings as a table of the kind that a project reads: its column names, its units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.files.data_entries import DataSpec
from loopcal.files.table_writer import Column, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.units import from_si

Array = NDArray[np.float64]


def readings_table(
    dataset: Dataset, spec: DataSpec | None, sds: Mapping[str, Array], ending: str
) -> bytes:
    """The bytes of a table of readings (.csv, .tsv, .parquet), blank where there is none.

    spec: how the project reads its data, None for quantities under their own names in SI; a
    column that it knows by number gets the quantity's name. sds: quantity -> (N,) [SI], for the
    columns of sds it asks for.
    """
    options = spec.options if spec else {}
    columns: dict[str, Column] = {}
    pose = options.get("pose")
    columns[pose if isinstance(pose, str) else "pose"] = dataset.poses
    for quantity, readings in dataset.readings.items():
        its = spec.columns.get(quantity) if spec else None
        name = its.column if its and isinstance(its.column, str) else quantity
        unit = its.unit if its and its.unit else "1"
        columns[name] = from_si(readings, unit)
        if its and isinstance(its.sd_column, str):
            sd = np.where(np.isfinite(sds[quantity]), sds[quantity], np.nan)
            columns[its.sd_column] = from_si(sd, its.sd_unit or unit)
    return table_bytes(columns, ending)
