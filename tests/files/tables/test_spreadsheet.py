"""XLSX: sheets, headers, rows as the spreadsheet counts them, and what is no workbook."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
import xlsxwriter

from loopcal.errors import InputError
from loopcal.files.tables.readers import read_dataset


@pytest.fixture
def path(tmp_path):
    """A workbook with a table that starts in cell B3, one without header, one empty sheet."""
    path = tmp_path / "arm.xlsx"
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet("left arm")
        rows = [["pose", "x", "y"], [1, 0.1, "n/a"], [2, 1 / 3, 2.5], [], [3, "0.3", None]]
        for i, row in enumerate(rows, 2):
            sheet.write_row(i, 1, row)
        sheet.write_formula(6, 3, "=NA()", None, "#N/A")
        bare = book.add_worksheet("bare")
        bare.write_row(0, 0, [1, 2.5])
        bare.write_row(1, 0, [3, "4.5 mm"])
        date = book.add_format({"num_format": "yyyy-mm-dd"})
        bare.write_datetime(2, 1, datetime.datetime(2024, 5, 17), date)
        book.add_worksheet("empty").write(4, 4, "-")
        book.add_worksheet("header").write_row(0, 0, ["x", "y"])
    return path


def test_the_first_sheet_with_its_rows_and_gaps(path):
    data = read_dataset(path, {"x": {"column": "x", "unit": "mm"}, "y": "y"}, pose="pose")
    np.testing.assert_array_equal(data["x"], np.array([0.1, 1 / 3, 0.3]) * 1e-3)
    np.testing.assert_array_equal(data["y"], [np.nan, 2.5, np.nan])
    assert data.poses == ("1", "2", "3")
    assert data.place(2, "x") == "arm.xlsx, sheet 'left arm', row 7, column 'x'"
    assert data.source.file == "arm.xlsx"
    assert len(data.source.sha256 or "") == 64


def test_sheets_by_name_and_number_and_columns_by_number(path):
    for sheet in ("bare", 2):
        data = read_dataset(path, {"x": 1}, sheet=sheet, exclude=[3])
        np.testing.assert_array_equal(data["x"], [1.0, 3.0])


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (["1,234", "0,5", 2.5], [1.234, 0.5, 2.5]),  # a comma that is no group of thousands
        (["1,234.5", "0.5", 2.5], [1234.5, 0.5, 2.5]),
        (["-3.25", "0.5", "1.5"], [-3.25, 0.5, 1.5]),
    ],
)
def test_numbers_stored_as_text_have_the_decimal_mark_of_the_sheet(tmp_path, cells, values):
    path = tmp_path / "arm.xlsx"
    with xlsxwriter.Workbook(path) as book:
        book.add_worksheet("left arm").write_column(0, 0, ["x", *cells])
    np.testing.assert_array_equal(read_dataset(path, {"x": "x"})["x"], values)


WRONG = {
    "text in a number": ({"sheet": "bare"}, {"x": 2}, ["row 2, column '2'", "'4.5 mm'"]),
    "a date in a number": ({"sheet": 2, "exclude": [2]}, {"x": 2}, ["row 3", "2024-05-17"]),
    "an unknown sheet": ({"sheet": "left arms"}, None, ["did you mean 'left arm'?"]),
    "a sheet number too high": ({"sheet": 5}, None, ["no sheet 5", "1 to 4", "'left arm', 'bare'"]),
    "an empty sheet": ({"sheet": "empty"}, None, ["sheet 'empty'", "the file is empty"]),
    "a header alone": ({"sheet": "header"}, None, ["row 1", "no row of data"]),
    "an unknown column": ({}, {"x": "X"}, ["sheet 'left arm'", "'pose', 'x', 'y'"]),
    "a delimiter": ({"delimiter": ","}, None, ["delimiter", "XLSX"]),
}


@pytest.mark.parametrize(("options", "columns", "parts"), WRONG.values(), ids=WRONG)
def test_wrong_requests(path, options, columns, parts):
    with pytest.raises(InputError) as caught:
        read_dataset(path, columns, **options)
    for part in ("arm.xlsx", *parts):
        assert part in str(caught.value)


@pytest.mark.parametrize("keep", [0, 8, 900], ids=["empty", "no zip", "cut off"])
def test_broken_workbooks(path, keep):
    path.write_bytes(path.read_bytes()[:keep].replace(b"PK", b"pk" if keep == 8 else b"PK"))
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert "arm.xlsx" in str(caught.value)
    assert ("empty" if not keep else "XLSX workbook") in str(caught.value)
    assert caught.value.remedy
