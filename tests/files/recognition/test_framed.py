"""The table among other lines of a file: titles, headers of several rows, units, remarks below."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.recognition.framed import framed_table

ROWS = "1,0.5,2.5,3.5\n2,1.5,4.5,6.5\n3,2.5,5.5,7.5\n4,2.0,1.0,9.0\n"
TITLE = "Take,7,Rate,120\n\n"


def names(tmp_path: Path, text: str, fewest: int = 2) -> tuple[str, ...]:
    """Of the columns of a text."""
    path = tmp_path / "data.csv"
    path.write_text(text)
    table, _ = framed_table(path, None, fewest)
    assert table.numbers(1, np.arange(4)).tolist() == [0.5, 1.5, 2.5, 2.0]
    return table.names


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("n,a,b,c\n", ("n", "a", "b", "c")),
        (",A,A,B\nn,x,y,x\n", ("n", "A x", "A y", "B x")),
        (",A,,B\nn,x,y,x\n", ("n", "A x", "A y", "B x")),  # as merged cells are written
        (",A,A,A\nn,x,y,z\n", ("n", "x", "y", "z")),
        ("n,a,b,c\n,deg,mm,mm\n", ("n", "a [deg]", "b [mm]", "c [mm]")),
        (",a,b,c\nindex,,,\n", ("", "a", "b", "c")),
        ("", ()),
    ],
)
@pytest.mark.parametrize("title", ["", TITLE, "A robot\n"])
def test_names_are_those_of_all_rows_of_a_header(
    tmp_path: Path, header: str, expected: tuple[str, ...], title: str
) -> None:
    if not header and title.startswith("A"):
        title += "// mm\n"
    assert names(tmp_path, title + header + ROWS) == expected


def test_what_stands_below_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{TITLE}n,a,b,c\n{ROWS}end of file\n")
    table, words = framed_table(tmp_path / "a.csv", None, 2)
    assert table.rows.tolist() == [4, 5, 6, 7]
    assert words == (
        "The first 3 rows of a.csv are no readings. They name the columns n, a, b, c. "
        "What stands below row 7 is no reading either."
    )


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_a_header_that_stands_again_among_the_readings_is_left_out(
    tmp_path: Path, delimiter: str
) -> None:
    """As of logs that were written one behind another: "'a' is not a number"."""
    lines = ["n,a,b,c,note", *(f"{row},ok" for row in ROWS.splitlines())]
    text = "\n".join([*lines[:3], lines[0], *lines[3:]]).replace(",", delimiter)
    (tmp_path / "a.csv").write_text(text)
    table, words = framed_table(tmp_path / "a.csv", None, 2)
    assert table.numbers(1, np.arange(4)).tolist() == [0.5, 1.5, 2.5, 2.0]
    assert table.rows.tolist() == [2, 3, 5, 6]
    assert words == "Row 4 of a.csv repeats the header: left out."


def test_a_row_of_another_width_between_readings_is_refused(tmp_path: Path) -> None:
    lines = ROWS.splitlines()
    text = "\n".join(["n,a,b,c", *lines[:2], "3,2.5,5.5", *lines[2:]])
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match="row 4"):
        framed_table(tmp_path / "a.csv", None, 2)


def test_a_text_in_utf_16_has_titles_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{TITLE}n,a,b,c\n{ROWS}", encoding="utf-16")
    table, _ = framed_table(path, None, 2)
    assert table.names == ("n", "a", "b", "c")
    assert np.array_equal(table.rows, [4, 5, 6, 7])
