"""Days of a measurement: as people write them, and as columns of readings hold them."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.files.tables.readers import read_dataset
from loopcal.measurements.days import Days

COLUMNS = {"x": "x"}


@pytest.mark.parametrize(
    ("text", "first", "last"),
    [
        ("2026-11-02", "2026-11-02", "2026-11-02"),
        (" 2026-11-02 to 2026-11-04 ", "2026-11-02", "2026-11-04"),
        ("2026-11-02/2026-11-04", "2026-11-02", "2026-11-04"),
    ],
)
def test_days_are_read(text: str, first: str, last: str) -> None:
    assert Days.of_text(text) == Days(first, last)


@pytest.mark.parametrize("text", ["", "2 Nov 2026", "2026-13-01", "2026-11-04 to 2026-11-02"])
def test_another_text_is_no_day(text: str) -> None:
    assert Days.of_text(text) is None


def _measured(folder: Path, text: str, **options: object) -> Days | None:
    path = folder / "a.csv"
    path.write_text(text)
    return read_dataset(path, COLUMNS, **options).source.measured  # type: ignore[arg-type]


def test_readings_are_dated_by_a_column_of_dates(tmp_path: Path) -> None:
    text = "id,x,at\nA,1,2026-03-01T08:30:00\nB,2,2026-03-02 09:00\nC,3,2026-03-09\n"
    assert _measured(tmp_path, text) == Days("2026-03-01", "2026-03-09")
    # of the poses that are used
    dated = _measured(tmp_path, text, pose="id", exclude=["C"])
    assert dated == Days("2026-03-01", "2026-03-02")


@pytest.mark.parametrize(
    "text",
    [
        "x,at\n1,2026-03-01\n2,later\n",
        "x,at\n1,08:30:00\n2,08:31:00\n",
        "x,at\n1,1772352000\n2,1772352060\n",
        "x,at,due\n1,2026-03-01,2027-01-01\n2,2026-03-01,2027-01-01\n",
    ],
)
def test_nothing_is_guessed_of_other_columns(tmp_path: Path, text: str) -> None:
    assert _measured(tmp_path, text) is None
