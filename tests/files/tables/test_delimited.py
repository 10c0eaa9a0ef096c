"""Delimited text: each way of writing a table is recognised and gives the same numbers exactly."""

from __future__ import annotations

import io
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loopcal.errors import InputError
from loopcal.files.tables.delimited import LARGE, read_delimited
from loopcal.files.tables.raw import read_text
from loopcal.files.tables.reader import Layout
from loopcal.files.tables.readers import read_dataset
from tests.refusals import refused

finite = st.floats(allow_nan=False, allow_infinity=False)


def table_of(text: str | bytes, large=LARGE, **options):
    data = text.encode() if isinstance(text, str) else text
    return read_delimited(read_text(io.BytesIO(data)), Layout(**options), large=large)


def columns_of(table) -> list[list[float]]:
    keep = np.arange(len(table.rows))
    return [table.numbers(i, keep).tolist() for i in range(len(table.columns))]


@st.composite
def written_tables(draw):
    """A table of numbers and one of the ways to write it down."""
    width, height = draw(st.integers(2, 5)), draw(st.integers(1, 6))
    cell = st.one_of(finite, st.none())
    values = draw(st.lists(st.tuples(*[cell] * (width - 1)), min_size=height, max_size=height))
    rows = [(float(i), *row) for i, row in enumerate(values, 1)]
    delimiter = draw(st.sampled_from([",", ";", "\t", " ", "   "]))
    decimal = "." if delimiter == "," else draw(st.sampled_from(".,"))
    missing = draw(
        st.sampled_from(["NaN", "nan", "NA", "n/a", "null", "#N/A", "-", "---", "failed"])
    )
    quote = draw(st.sampled_from(["", '"'])) if delimiter == "," else ""
    padding = draw(st.sampled_from(["", " "])) if not quote else ""

    def written(number: float | None) -> str:
        text = missing if number is None else repr(number).replace(".", decimal)
        return f"{quote}{text}{quote}{padding}"

    lines = [delimiter.join(map(written, row)) for row in rows]
    lines += draw(st.sampled_from([[], ["", "# the end"], [";;;;"]]))
    if draw(st.booleans()):
        lines.insert(0, delimiter.join(f"q_{i}" for i in range(width)))
    if draw(st.booleans()):
        lines = [draw(st.sampled_from(["# measured", "% gemessen: müh-sam", ""])), *lines]
    if delimiter.strip() and draw(st.booleans()):
        lines = [line + delimiter for line in lines]
    ending = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    text = ending.join(lines) + draw(st.sampled_from(["", ending]))
    codings = ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"]
    return rows, text.encode(draw(st.sampled_from(codings)))


@settings(max_examples=300)
@given(written_tables())
def test_every_way_of_writing_a_table_reads_back_exactly(case):
    rows, data = case
    expected = [
        [math.nan if v is None else v for v in column] for column in zip(*rows, strict=True)
    ]
    np.testing.assert_array_equal(columns_of(table_of(data)), expected)


NUMBERS = ("1", "-3", "+1.5", ".5", "2.", "1e5", "1E-5", " 4 ", "\u00a05", '"6"', "0.1e-400")
MISSING = ("", " ", "nan", "NaN", "+nan", "-nan", "NAN", "NA", "#N/A", "-", "null")
INFINITE = ("inf", "-Infinity", "infinity", "1e999", "1e400")
WRONG = ("1_0", "0x1", "1d5", "1e", "--1", "x", "1.2.3", "1,5", "true", "١", "∞", "−1", "1 2")
cell = st.one_of(finite.map(repr), st.sampled_from((*NUMBERS, *MISSING, *INFINITE, *WRONG)))


@settings(max_examples=150)
@given(
    st.lists(st.tuples(cell, cell, st.integers().map(str)), min_size=2, max_size=30),
    st.sampled_from([";", "\t"]),
    st.sampled_from([".", ","]),
    st.sampled_from(["", "# a comment", ";;", " ;\t; ", ",,", "   ", "2", "%"]),
)
def test_the_fast_way_reads_what_the_careful_way_reads(rows, delimiter, decimal, odd):
    lines = ["a;b;c", *(";".join(row) for row in rows)]
    lines.insert(len(lines) // 2 + 1, odd)
    text = "\n".join(lines).replace(";", delimiter) + "\n"

    def outcome(large: int) -> object:
        try:
            table = table_of(text, delimiter=delimiter, decimal=decimal, header=True, large=large)
        except InputError as error:
            return str(error)
        found: list[object] = [table.rows.tolist()]
        for i in range(3):
            try:
                found.append(repr(table.numbers(i, np.arange(len(table.rows)))))
            except InputError as error:
                found.append(str(error))
        return [*found, table.ids(0)]

    assert outcome(large=0) == outcome(large=10**9)


def test_a_large_plain_file_takes_the_fast_way_and_an_error_in_it_is_placed():
    values = np.random.default_rng(5).normal(size=(20_000, 4))
    lines = ["w,x,y,z", *(",".join(map(repr, row)) for row in values.tolist())]
    table = table_of("\n".join(lines))
    assert type(table.columns[0]).__module__.startswith("polars")
    np.testing.assert_array_equal(np.transpose(columns_of(table)), values)
    lines[12_345] = "1,2,3_0,4"
    with refused("invalid-number", "row 12346", "column 'y'", "'3_0'"):
        columns_of(table_of("\n".join(lines)))
    lines[12_345] = "1,2,3"
    with refused("invalid-syntax", "row 12346", "3 cells", "4"):
        table_of("\n".join(lines))


def test_white_space_divides_in_a_large_file_as_in_a_small_one():
    text = "\n".join(["% saved by hand", *(f"  {i}.5   -{i}\t 7 " for i in range(1000))])
    for large in (0, 10**9):
        table = table_of(text, large=large)
        assert columns_of(table)[1] == [-float(i) for i in range(1000)]
        assert table.rows[0] == 2


def test_a_small_file_is_read_without_loading_heavy_libraries(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y\n1,2\n3,5\n")
    code = f"""
import sys
from loopcal.files.tables.readers import read_dataset
read_dataset({str(path)!r})
print([m for m in ("polars", "python_calamine", "scipy.io", "pandas") if m in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        ("x\n1,5\n2,5\n", {}, [[1.5, 2.5]]),
        ("1,2\n3,4\n", {}, [[1, 3], [2, 4]]),
        ('x,y\n"1,5","2,5"\n', {}, [[1.5], [2.5]]),
        ("1, 2.5\n3, 4.5\n", {}, [[1, 3], [2.5, 4.5]]),
        ("x;y;\n1;;\n3;4;\n", {}, [[1, 3], [math.nan, 4]]),
        ("1;2;\n3;4;\n", {}, [[1, 3], [2, 4]]),
        ("x,y,,,\n1,2,,,\n,,,,\n3,4,,,\n", {}, [[1, 3], [2, 4]]),
        ("1,2,\n3,4,5\n6,7,\n", {}, [[1, 3, 6], [2, 4, 7], [math.nan, 5, math.nan]]),
        ("1|2\n3|4\n", {"delimiter": "|"}, [[1, 3], [2, 4]]),
        ("1\t2\n3\t4\n", {"delimiter": "tab"}, [[1, 3], [2, 4]]),
        ("5\n6\n", {"header": False}, [[5, 6]]),
        ("#N/A,1\n2,3\n", {}, [[math.nan, 2], [1, 3]]),
        ('a b\n"1" 2\n  3   4\n', {}, [[1, 3], [2, 4]]),
    ],
)
def test_small_cases_by_hand(text, options, expected):
    np.testing.assert_array_equal(columns_of(table_of(text, **options)), expected)


def test_header_and_row_numbers_are_those_of_an_editor():
    table = table_of("# title\n\npose, x [m]\na,1\n\n# break\nb,2\n")
    assert table.names == ("pose", "x [m]")
    assert table.rows.tolist() == [4, 7]


def test_ids_of_text_do_not_make_the_first_row_a_header():
    table = table_of("p1,1.5\np2,2.5\n")
    assert table.names == ()
    assert table.ids(0) == ("p1", "p2")


def test_stated_header_wins_over_what_it_looks_like():
    table = table_of("1,2\n3,4\n", header=True)
    assert table.names == ("1", "2")
    assert columns_of(table) == [[3.0], [4.0]]


def test_standard_input_is_read_like_a_file(monkeypatch):
    class Stdin:
        buffer = io.BytesIO(b"x,y\n1,2\n3,oops\n")

    monkeypatch.setattr(sys, "stdin", Stdin)
    with refused("invalid-number", "row 3", "column 'y'"):
        read_dataset("-", {"x": "x", "y": "y"})
    data = read_dataset(io.BytesIO(b"x\n1\n2\n"))
    assert data.source.file == "-"
    np.testing.assert_array_equal(data["x"], [1.0, 2.0])
