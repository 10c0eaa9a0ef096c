"""Numbers out of a polars column: the same rule as for single cells, at the speed of polars."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.files.tables import cells

if TYPE_CHECKING:
    import polars as pl


def numbers(series: pl.Series, keep: NDArray[np.int64], decimal: str) -> NDArray[np.float64]:
    """See `cells.numbers`.

    Polars converts plain numbers; each different text that it refuses is left to `cells.number`.
    """
    import polars as pl

    if len(keep) < len(series):
        series = series.gather(pl.Series(keep))
    if series.dtype != pl.String:
        return _converted(series, keep)
    plain = series.str.strip_chars()
    plain = plain.str.replace(",", ".", literal=True) if decimal == "," else plain
    values = plain.cast(pl.Float64, strict=False)
    refused = values.is_null()
    if decimal == ",":  # there a point is no decimal mark, whatever polars thinks of it
        refused |= series.str.contains(".", literal=True).fill_null(True)
    result = values.to_numpy().copy()
    if refused.any():
        table = {text: _number(text, decimal) for text in series.filter(refused).unique()}
        where = np.flatnonzero(refused.to_numpy())
        for i, text in zip(where, series.filter(refused), strict=True):
            value = table[text]
            if value is None:
                raise cells.NotANumber(int(keep[i]), text)
            result[i] = value
    return result


def _number(text: str | None, decimal: str) -> float | None:
    try:
        return cells.number(text, decimal)
    except ValueError:
        return None


def _converted(series: pl.Series, keep: NDArray[np.int64]) -> NDArray[np.float64]:
    import polars as pl

    if series.dtype.is_numeric() or series.dtype == pl.Null:
        return series.cast(pl.Float64).to_numpy()  # often the column itself, not to be written to
    for i, value in enumerate(series):
        if value is not None:
            raise cells.NotANumber(int(keep[i]), value)
    return np.full(len(series), np.nan)
