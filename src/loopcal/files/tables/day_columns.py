"""The days on which readings were measured, by a column of dates beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.files.tables.cells import is_missing
from loopcal.files.tables.table import Table
from loopcal.measurements.days import Days


def measured_days(table: Table, keep: NDArray[np.int64]) -> Days | None:
    """Of the rows to keep; None without a column of dates, and where two of them disagree.

    A date is written as ISO 8601 does, with or without a time. No header is needed.
    """
    numeric = set(table.numeric())
    days = {
        found
        for position, cells in table.columns.items()
        if position not in numeric and (found := _days_of(cells, keep)) is not None
    }
    # Which of several columns is that of the measurement is not guessed.
    return days.pop() if len(days) == 1 else None


def _days_of(cells: Any, keep: NDArray[np.int64]) -> Days | None:
    stated = (cells[int(i)] for i in keep)
    return Days.of_moments(str(cell) for cell in stated if not is_missing(cell))
