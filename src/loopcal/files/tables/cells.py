"""Numbers and ids out of the cells of one column, by one rule for every kind of file.

A number is an optional sign, digits with at most one decimal mark, and an optional exponent;
thousands separators are not guessed. A cell that is blank or says NaN, NA, n/a, #N/A, null,
none or - (in any case of letters) is missing and becomes NaN.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.poses import pose_id

if TYPE_CHECKING:
    import polars as pl

Cells: TypeAlias = "list[object] | list[str] | NDArray[np.float64] | pl.Series"

MISSING = frozenset(("", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-"))
_FORM = r"[+-]?(?:\d+MARK?\d*|MARK\d+)(?:[eE][+-]?\d+)?"
_NUMBER = {mark: re.compile(_FORM.replace("MARK", f"[{mark}]"), re.ASCII) for mark in ".,"}
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.IGNORECASE)


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
    try:
        return not math.isnan(number(cell, decimal))
    except ValueError:
        return False


def numbers(
    cells: list[Any] | NDArray[np.float64], keep: NDArray[np.int64], decimal: str = "."
) -> NDArray[np.float64]:
    """The column (N,) as numbers, at the positions to keep; the others are not looked at.

    Columns of polars: see `series.numbers`.

    Raises NotANumber for the first cell that is neither number nor missing.
    """
    if isinstance(cells, np.ndarray):
        return cells[keep]
    result = np.empty(len(keep))
    for i, index in enumerate(keep):
        try:
            result[i] = number(cells[index], decimal)
        except ValueError:
            raise NotANumber(int(index), cells[index]) from None
    return result


def mostly_numbers(cells: Cells, decimal: str = ".") -> bool:
    """Whether a column is one of numbers: half of what its first rows hold, or more."""
    if isinstance(cells, np.ndarray) or (not isinstance(cells, list) and cells.dtype.is_numeric()):
        return True
    first = cells[:1000] if isinstance(cells, list) else cells.head(1000).to_list()
    here = [cell for cell in first if not is_missing(cell) and cell == cell]
    return 2 * sum(is_number(cell, decimal) for cell in here) >= len(here) > 0


def ids(cells: Cells) -> tuple[str, ...]:
    """The column (N,) as ids of poses."""
    return tuple(map(pose_id, cells))
