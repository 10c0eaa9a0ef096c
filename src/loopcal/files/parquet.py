"""A Parquet file as a table; only the columns asked for are read."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from loopcal.errors import InputError
from loopcal.files.raw import empty, existing_file, sha256_of
from loopcal.files.table import Table, find_column


def read_parquet(path: str | Path, *, wanted: Collection[str | int] | None = None) -> Table:
    """The columns wanted (all of them for None); null is missing, rows count from 1.

    Raises InputError for a file that is no Parquet, a column that is not there, no rows.
    """
    import polars as pl

    path = existing_file(path)
    try:
        names = tuple(pl.read_parquet_schema(path))
        asked = range(1, len(names) + 1) if wanted is None else wanted
        positions = sorted({find_column(c, names, len(names), path.name) for c in asked})
        frame = pl.read_parquet(path, columns=[names[i] for i in positions], glob=False)
    except (pl.exceptions.PolarsError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"this is no Parquet file that can be read ({reason})",
            place=path.name,
            remedy="write it again, or save it as CSV",
        ) from None
    if not frame.height:
        raise empty(path.name)
    columns = dict(zip(positions, frame.get_columns(), strict=True))
    rows = np.arange(1, frame.height + 1, dtype=np.int64)
    return Table(path.name, None, sha256_of(path), names, columns, rows)
