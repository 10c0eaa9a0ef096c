"""Columns of numbers out of whatever table a user holds: a dict of arrays or any DataFrame.

Tables are recognised by what they offer (names, and columns by name), so that no DataFrame
library is imported here: pandas, polars, a pyarrow Table and a structured array all do.
"""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest


def column_names(table: Any) -> tuple[str, ...]:
    """Names of the columns of a table.

    Raises InputError when it is no table with named columns.
    """
    if isinstance(table, Mapping):
        names = list(table)
    elif hasattr(table, "column_names"):  # pyarrow, whose `columns` are the data
        names = list(table.column_names)
    elif hasattr(table, "columns"):
        names = list(table.columns)
    elif getattr(getattr(table, "dtype", None), "names", None):
        names = list(table.dtype.names)
    else:
        raise InputError(
            f"a {type(table).__name__} has no named columns",
            code="wrong-shape",
            remedy="give a dict of arrays, {'x': [...], ...}, or a DataFrame",
        )
    for name in names:
        if not isinstance(name, str):
            raise InputError(
                f"the column name {name!r} is not text",
                code="invalid-value",
                remedy="name columns by quantity",
            )
    return tuple(names)


def column(table: Any, name: str) -> Any:
    """The column called `name`; InputError naming the nearest where there is none."""
    names = column_names(table)
    if name not in names:
        raise InputError(
            f"there is no column {name!r}", code="missing-column", remedy=nearest(name, names)
        )
    return table[name]


def as_numbers(values: Any, what: str) -> NDArray[np.float64]:
    """One column as (N,) float64, with NaN wherever a value is missing (None, NA, masked).

    Raises InputError for text, booleans, complex numbers, dates and anything not 1-D.
    """
    if isinstance(values, np.ma.MaskedArray):
        values = np.where(np.ma.getmaskarray(values), np.nan, values.data)
    array = np.asarray(values)
    if array.ndim != 1:
        raise InputError(
            f"{what} has shape {array.shape}",
            code="wrong-shape",
            remedy="give one value per pose: a 1-D array",
        )
    if array.dtype.kind in "fiu":
        return array.astype(np.float64)
    if array.dtype.kind == "O":
        return np.array(
            [_number(value, what, row) for row, value in enumerate(array, 1)], dtype=np.float64
        )
    if array.size == 0:
        return np.empty(0)
    raise InputError(
        f"{what} holds {array.dtype.name} values ({array[0]!s}), not real numbers",
        code="invalid-number",
        remedy="convert it to numbers, or remove it",
    )


def _number(value: object, what: str, row: int) -> float:
    if value is None or repr(value) in ("<NA>", "NaT"):
        return float("nan")
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, numbers.Number | np.number) and not isinstance(value, bool | complex):
        return float(cast(float, value))
    raise InputError(
        f"{what}: value {row} is {value!r}, not a number",
        code="invalid-number",
        remedy="convert it to a number, or to NaN where nothing was measured",
    )
