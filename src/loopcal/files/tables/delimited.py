"""CSV, TSV and other delimited text as a table.

Two ways lead there, with one result. The careful one takes row after row, knows each row's
number and names whatever is wrong. The fast one gives the text to polars, which alone pays the
time to load it: for text of 1 MB or more that needs no care (no quotes, all rows alike).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.tables.cells import Cells
from loopcal.files.tables.dialect import (
    SAMPLE_ROWS,
    WHITESPACE,
    Dialect,
    Row,
    cut,
    only_header,
    quote_error,
    recognise,
    spoken,
)
from loopcal.files.tables.raw import Text, empty, read_text
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table

_COMMENTS = 15
"""Comments above the rows, one of which may be their header."""
_HEAD = 500
"""Lines that hold the names of columns and some rows."""
LARGE = 1_000_000  # bytes from which on loading polars pays
_LINES = re.compile(rb"[ \t,;\n]*+(?:(?:%|#(?!n/a))[^\n]*|([^ \t,;\n][^\n]*)|\Z)", re.IGNORECASE)
"""Lines up to the next that holds cells: blank ones, delimiters alone, at most one comment."""


def read_delimited(text: Text, layout: Layout = RECOGNISED, *, large: int = LARGE) -> Table:
    """The table in a text; whatever is not stated is recognised.

    `large` is the size [bytes] from which on the fast way is tried. Raises InputError, with the
    row, for a text without rows of data, rows of unequal length and quotes that do not end.
    """
    sample = [*islice(_rows(text.data), SAMPLE_ROWS)]
    if not sample:
        raise empty(text.name)
    dialect = recognise(sample, text.name, layout, _above(text.data, sample[0].number))
    table = _fast(text, dialect) if len(text.data) >= large else None
    return table or _careful(text, dialect)


def read_text_file(
    source: str | Path | BinaryIO, layout: Layout = RECOGNISED, *, wanted: object = None
) -> Table:
    """The table in a text file, with all its columns."""
    return read_delimited(read_text(source, layout.encoding), layout)


def names_in(source: str | Path | BinaryIO, layout: Layout = RECOGNISED) -> tuple[str, ...]:
    """Names of all columns of a text file, by its first rows where these are a table."""
    text = read_text(source, layout.encoding)
    head = b"\n".join(text.data.split(b"\n", _HEAD)[:_HEAD])
    with suppress(InputError):  # a long comment, or a fault that the whole names by its row
        return read_delimited(replace(text, data=head), layout).names
    return read_delimited(text, layout).names


READER = Reader(
    "text",
    "a row per line; delimiter, decimal mark, header and encoding are recognised",
    (".csv", ".tsv", ".txt", ".dat", ".asc", ".prn"),
    read_text_file,
    ("header", "delimiter", "decimal", "encoding", "spread"),
    guarded=False,
)


def _rows(data: bytes) -> Iterator[Row]:
    """The lines that hold cells; blank ones between them cost next to nothing."""
    number, counted = 1, 0
    for match in _LINES.finditer(data):
        if match[1] is not None:
            start = data.rfind(b"\n", 0, match.start(1)) + 1
            number += data.count(b"\n", counted, start)
            counted = start
            yield Row(number, data[start : match.end()].decode("utf-8"))


def _above(data: bytes, first: int) -> list[Row]:
    """The last comments above a row, the nearest first, without their marks."""
    end = 0
    for _ in range(first - 1):
        end = data.find(b"\n", end) + 1
    comments: list[Row] = []
    for number in range(first - 1, max(first - 1 - _COMMENTS, 0), -1):
        start = data.rfind(b"\n", 0, end - 1) + 1
        line = data[start:end].decode("utf-8").strip()
        if line.startswith(("#", "%")):
            comments.append(Row(number, line.lstrip("#%").strip()))
        end = start
    return comments


def _careful(text: Text, dialect: Dialect) -> Table:
    cells: list[list[str]] = []
    numbers: list[int] = []
    for row in _rows(text.data):
        if row.number <= dialect.header_row:
            continue
        try:
            line = cut(row.line, dialect.delimiter)
        except csv.Error:
            raise quote_error(text.name, row) from None
        if len(line) != dialect.width:
            line = _fitted(line, dialect, f"{text.name}, row {row.number}")
        cells.append(line)
        numbers.append(row.number)
    if not cells:
        raise only_header(f"{text.name}, row {dialect.header_row}")
    columns = {i: list(column) for i, column in enumerate(zip(*cells, strict=True))}
    return _table(text, dialect, columns, np.array(numbers, dtype=np.int64))


def _fitted(cells: list[str], dialect: Dialect, place: str) -> list[str]:
    if len(cells) > dialect.width and not any(cells[dialect.width :]):
        return cells[: dialect.width]
    raise InputError(
        f"this row has {len(cells)} cells, where {dialect.width} are expected "
        f"(delimiter {spoken(dialect.delimiter)})",
        code="invalid-syntax",
        place=place,
        remedy="complete the row, comment it out with #, or state the delimiter",
    )


def _fast(text: Text, dialect: Dialect) -> Table | None:
    """The table by polars; None where the text is not plain enough for it."""
    import polars as pl

    start = 0
    for _ in range(dialect.header_row):
        start = text.data.find(b"\n", start) + 1
        if not start:
            return None
    body = text.data[start:] if start else text.data
    # polars takes delimiters of one byte only.
    if b'"' in body or not dialect.delimiter.isascii():
        return None
    body, rows = _plain(body, dialect)
    separator = dialect.delimiter.encode()
    if not len(rows) or body.count(separator) != len(rows) * (dialect.width - 1):
        return None
    names = [str(i) for i in range(dialect.width)]
    try:
        frame = pl.read_csv(
            body,
            has_header=False,
            new_columns=names,
            separator=dialect.delimiter,
            quote_char=None,
            infer_schema=False,
        ).fill_null("")
    except pl.exceptions.PolarsError:
        return None
    # No row is longer than the first, and the delimiters add up: then no row is shorter either.
    if frame.shape != (len(rows), dialect.width):
        return None
    return _table(text, dialect, dict(enumerate(frame.get_columns())), rows)


def _plain(body: bytes, dialect: Dialect) -> tuple[bytes, NDArray[np.int64]]:
    """The rows of data alone, and their numbers in the file."""
    first = dialect.header_row + 1
    starts = {"\n", " ", "\t", dialect.delimiter}  # of lines that may hold nothing
    suspect = body[:1].decode("latin-1") in starts or any(
        part in body for part in (b"#", b"%", *(f"\n{start}".encode() for start in starts))
    )
    if dialect.delimiter != WHITESPACE and not suspect:
        number = body.count(b"\n") + (not body.endswith(b"\n"))
        return body, np.arange(first, first + number, dtype=np.int64)
    numbers, lines = [], []
    for row in _rows(body):
        numbers.append(row.number)
        line = row.line
        lines.append(" ".join(cut(line, WHITESPACE)) if dialect.delimiter == WHITESPACE else line)
    return "\n".join(lines).encode("utf-8"), np.array(numbers, dtype=np.int64) + first - 1


def _table(
    text: Text, dialect: Dialect, columns: Mapping[int, Cells], rows: NDArray[np.int64]
) -> Table:
    return Table(text.file, None, text.sha256, dialect.names, columns, rows, dialect.decimal)
