"""Cells that hold their unit: the numbers are read, and the unit moves into the header."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.files.recognition.framed import with_units_in_names
from loopcal.files.tables.table import Table


def table(*cells: str, name: str = "a", decimal: str = ".") -> Table:
    """Of one column."""
    rows = np.arange(len(cells), dtype=np.int64)
    return Table("a.csv", None, "", (name,), {0: [*cells]}, rows, decimal)


@pytest.mark.parametrize(
    ("cells", "name", "values"),
    [
        (("12.5°", "-3°"), "a [deg]", [12.5, -3.0]),
        (("12.5 mm", "", "1 mm"), "a [mm]", [12.5, np.nan, 1.0]),
        (("1,234.5 mm", "2 mm"), "a [mm]", [1234.5, 2.0]),
        (("48° 30' 36\"", "-0°00'36.0\""), "a [deg]", [48.51, -0.01]),
    ],
)
def test_numbers_and_unit(cells: tuple[str, ...], name: str, values: list[float]) -> None:
    made, words = with_units_in_names(table(*cells))
    assert made.names == (name,)
    assert np.allclose(made.numbers(0, np.arange(len(cells))), values, equal_nan=True)
    assert "'" + name + "'" in words


@pytest.mark.parametrize(
    ("cells", "name"),
    [
        (("12.5°", "3 mm"), "a"),  # no unit of the column
        (("12.5 mm", "3 mm"), "a [deg]"),  # the header contradicts them
        (("12 apples", "3 apples"), "a"),
        (("10:15:30", "10:15:31"), "a"),  # times of the day
        (("P1", "P2"), "a"),
        (("1.5", "2.5"), "a"),
    ],
)
def test_other_cells_stay(cells: tuple[str, ...], name: str) -> None:
    before = table(*cells, name=name)
    assert with_units_in_names(before) == (before, "")
