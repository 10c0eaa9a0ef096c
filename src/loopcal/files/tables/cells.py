"""Numbers and ids out of the cells of one column, by one rule for every kind of file.

A number is an optional sign, digits with at most one decimal mark, and an optional exponent. Groups
of thousands are read where they are certain: the cell has the decimal mark too ("1,234.5"), several
groups, or blanks or apostrophes between them; a cell such as "1,234" only where others of its
column are so. A cell that is blank or says NaN, NA, n/a, #N/A, null, none, missing, failed, invalid
or dashes (in any case of letters) is missing and becomes NaN; so does an error of a spreadsheet.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.poses import pose_id

if TYPE_CHECKING:
    import polars as pl

Cells: TypeAlias = "list[object] | list[str] | NDArray[np.float64] | pl.Series"

MISSING = frozenset(
    (
        *("", "nan", "+nan", "-nan", "na", "n/a", "n.a.", "#n/a", "null", "none", "nil"),
        *("missing", "failed", "invalid", "#value!", "#div/0!", "#ref!", "#num!"),
        *("-", "--", "---", "----", "\u2013", "\u2014"),
    )
)
# Possessive: a long cell cannot make the match back out (docs/decisions/0137).
_FORM = r"[+-]?(?:\d++MARK?\d*+|MARK\d++)(?:[eE][+-]?\d++)?"
_NUMBER = {mark: re.compile(_FORM.replace("MARK", f"[{mark}]"), re.ASCII) for mark in ".,"}
_BLANKS = " \u00a0\u202f\u2009'\u2019"
# No group of thousands begins with a zero: 0,123 is a decimal number.
_GROUP = r"[+-]?[1-9]\d{0,2}"
_OTHER = {".": ",", ",": "."}
_GROUPED = {
    mark: re.compile(
        rf"{_GROUP}(?:([{_BLANKS}{_OTHER[mark]}])\d{{3}}(?:\1\d{{3}})*[{mark}]\d*"
        rf"|([{_BLANKS}])\d{{3}}(?:\2\d{{3}})*|[{_OTHER[mark]}]\d{{3}}(?:[{_OTHER[mark]}]\d{{3}})+)",
        re.ASCII,
    )
    for mark in ".,"
}
_UNSURE = {mark: re.compile(rf"{_GROUP}[{_OTHER[mark]}]\d{{3}}", re.ASCII) for mark in ".,"}
"""Thousands, or the other decimal mark."""
_SEPARATORS = {mark: re.compile(f"[{_BLANKS}{_OTHER[mark]}]") for mark in ".,"}
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.IGNORECASE | re.ASCII)


class NotANumber(ValueError):
    """A cell that is neither a number nor missing; `index` is its position in the column."""

    def __init__(self, index: int, cell: object) -> None:
        super().__init__(index, cell)
        self.index = index
        self.cell = cell


def number(cell: object, decimal: str = ".") -> float:
    """The number in a cell, NaN where it is missing; ValueError for anything else.

    >>> number(" 1,5 ", decimal=","), number("n/a")
    (1.5, nan)
    """
    if isinstance(cell, float | int) and not isinstance(cell, bool):
        return float(cell)
    if cell is None:
        return math.nan
    if not isinstance(cell, str):
        raise ValueError(cell)
    text = cell.strip()
    if _NUMBER[decimal].fullmatch(text):
        return float(text.replace(",", "."))
    if _GROUPED[decimal].fullmatch(text):
        return float(_SEPARATORS[decimal].sub("", text).replace(",", "."))
    if text.lower() in MISSING:
        return math.nan
    if _INFINITE.fullmatch(text):
        return float(text)
    raise ValueError(cell)


def is_missing(cell: object) -> bool:
    """Whether a cell stands for a value that was not measured."""
    return cell is None or (isinstance(cell, str) and cell.strip().lower() in MISSING)


def is_number(cell: object, decimal: str = ".") -> bool:
    """Whether a cell holds a number; a missing one does not."""
    if isinstance(cell, str):
        text = cell.strip()
        found = _NUMBER[decimal].fullmatch(text) or _GROUPED[decimal].fullmatch(text)
        return (found or _INFINITE.fullmatch(text)) is not None
    try:
        return not math.isnan(number(cell, decimal))
    except ValueError:
        return False


def numbers(cells: Cells, keep: NDArray[np.int64], decimal: str = ".") -> NDArray[np.float64]:
    """The column (N,) as numbers, at the positions to keep; the others are not looked at.

    Raises NotANumber for the first cell that is neither number nor missing.
    """
    if isinstance(cells, np.ndarray):
        return cells[keep]
    if not isinstance(cells, list):
        return _series_numbers(cells, keep, decimal)
    result = np.empty(len(keep))
    for i, index in enumerate(keep):
        try:
            result[i] = number(cells[index], decimal)
        except ValueError:
            raise NotANumber(int(index), cells[index]) from None
    return result


def _series_numbers(
    series: pl.Series, keep: NDArray[np.int64], decimal: str
) -> NDArray[np.float64]:
    """A column of polars at its speed: it converts plain numbers, and each different text that it
    refuses is left to `number`."""
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
        table = {text: _number_or_none(text, decimal) for text in series.filter(refused).unique()}
        where = np.flatnonzero(refused.to_numpy())
        for i, text in zip(where, series.filter(refused), strict=True):
            value = table[text]
            if value is None:
                raise NotANumber(int(keep[i]), text)
            result[i] = value
    return result


def _number_or_none(text: str | None, decimal: str) -> float | None:
    try:
        return number(text, decimal)
    except ValueError:
        return None


def _converted(series: pl.Series, keep: NDArray[np.int64]) -> NDArray[np.float64]:
    import polars as pl

    if series.dtype.is_numeric() or series.dtype == pl.Null:
        return series.cast(pl.Float64).to_numpy()  # often the column itself, not to be written to
    for i, value in enumerate(series):
        if value is not None:
            raise NotANumber(int(keep[i]), value)
    return np.full(len(series), np.nan)


def ungrouped(cells: Cells, decimal: str) -> list[object] | None:
    """The column with groups of thousands joined where its other cells show them; else None."""
    if isinstance(cells, np.ndarray):
        return None
    texts = [c.strip() if isinstance(c, str) else c for c in cells]
    if not any(isinstance(t, str) and _GROUPED[decimal].fullmatch(t) for t in texts):
        return None
    return [
        _SEPARATORS[decimal].sub("", t)
        if isinstance(t, str) and _UNSURE[decimal].fullmatch(t)
        else t
        for t in texts
    ]


def may_be_grouped(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number of thousands or one with the other decimal mark."""
    return _UNSURE[decimal].fullmatch(cell.strip()) is not None


def mostly_numbers(cells: Cells, decimal: str = ".") -> bool:
    """Whether a column is one of numbers: half of what its first rows hold, or more."""
    if isinstance(cells, np.ndarray) or (not isinstance(cells, list) and cells.dtype.is_numeric()):
        return True
    first = cells[:1000] if isinstance(cells, list) else cells.head(1000).to_list()
    # NaN alone differs from itself.
    present = [cell for cell in first if not is_missing(cell) and cell == cell]
    return 2 * sum(is_number(cell, decimal) for cell in present) >= len(present) > 0


def ids(cells: Cells) -> tuple[str, ...]:
    """The column (N,) as ids of poses."""
    return tuple(map(pose_id, cells))
