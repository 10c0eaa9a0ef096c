"""Tables of numbers as CSV, TSV or Parquet; floats are written so that they read back exactly."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.measurements.poses import cell_text

Column = Sequence[str] | NDArray[np.float64]
SEPARATORS = {".csv": ",", ".tsv": "\t", ".txt": "\t"}
PARQUET = (".parquet", ".pq")
LARGE = 20_000
"""Rows from which on loading polars pays."""
COMPRESSION: Final = "snappy"
"""Measured digits are hardly compressed by anything, but others take twice the time."""


def table_bytes(columns: Mapping[str, Column], ending: str = ".csv") -> bytes:
    """The bytes of a table with a header; NaN becomes an empty cell.

    In text, names and texts that a spreadsheet would take for a formula are marked (`cell_text`).
    columns: name -> N texts, or N numbers. Raises InputError for an ending that is not written.
    """
    ending = ending.lower()
    _refuse_ending(ending)
    if ending in PARQUET:
        return _by_polars(columns, None)
    rows = len(next(iter(columns.values())))
    if rows >= LARGE:
        return _by_polars(columns, SEPARATORS[ending])
    cells = [_cells(column) for column in columns.values()]
    text = io.StringIO()
    writer = csv.writer(text, delimiter=SEPARATORS[ending], lineterminator="\n")
    writer.writerow(map(cell_text, columns))
    writer.writerows(zip(*cells, strict=True))
    return text.getvalue().encode("utf-8")


def check_ending(path: str | Path) -> None:
    """Raise InputError, before any work is done, for a table that could not be written."""
    _refuse_ending(Path(path).suffix.lower(), str(path))


def _refuse_ending(ending: str, place: str | None = None) -> None:
    if ending not in (*SEPARATORS, *PARQUET):
        raise InputError(
            f"a table cannot be written as {ending or 'a file without an ending'}",
            code="wrong-file-type",
            place=place,
            remedy="name a file that ends in .csv, .tsv or .parquet",
        )


def _cells(column: Column) -> Sequence[str]:
    if not isinstance(column, np.ndarray):
        return [*map(cell_text, column)]
    # repr gives the shortest digits that read back exactly; NaN alone differs from itself.
    return ["" if value != value else repr(value) for value in column.tolist()]


def _by_polars(columns: Mapping[str, Column], separator: str | None) -> bytes:
    import polars as pl

    mark = str if separator is None else cell_text
    frame = pl.DataFrame(
        {
            mark(name): pl.Series(
                column if isinstance(column, np.ndarray) else [*map(mark, column)]
            )
            for name, column in columns.items()
        }
    ).fill_nan(None)
    out = io.BytesIO()
    if separator is None:
        frame.write_parquet(out, compression=COMPRESSION)
    else:
        frame.write_csv(out, separator=separator)
    return out.getvalue()
