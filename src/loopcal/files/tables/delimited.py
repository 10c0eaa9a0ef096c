"""CSV, TSV and other delimited text as a table.

Two ways lead there, with one result. The careful one takes row after row, knows each row's
number and names whatever is wrong. The fast one gives the text to polars, which alone pays the
time to load it: for text of 1 MB or more that needs no care (no quotes, all rows alike).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.tables.cells import Cells, is_missing, is_number
from loopcal.files.tables.raw import Text, empty, read_text
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table

# How a delimited text is written: delimiter, decimal mark, header; recognised or stated.
#
# Every way of writing is tried on the first rows, and the one that turns the largest share of
# their cells into numbers, in rows of equal length, is taken. Comments start with # or %; rows
# that are blank or hold nothing but delimiters are passed over. A comment above rows without a
# header is their header where it names as many columns as they have.


WHITESPACE = " "
DELIMITERS = ("\t", ";", ",", WHITESPACE)  # in this order where two would do
_WORDS = {"\t": "tab", WHITESPACE: "white space"}
_SPOKEN = {
    **dict.fromkeys(("tab", r"\t"), "\t"),
    **dict.fromkeys(("space", "whitespace", r"\s+"), WHITESPACE),
    **{"comma": ",", "semicolon": ";"},
}
SAMPLE_ROWS = 100
_FEWEST = 3
"""Columns whose names a comment may hold: a comment of a few words names fewer."""
_RUN = re.compile(r"[ \t]+")
_UNIT_BEHIND = re.compile(r"(?<=\d)\s{0,3}(?P<unit>[^\W\d_]{1,4}|°)$")
_LONGEST_UNIT = 7
"""Characters of a unit with the blanks before it."""
_BEFORE_UNIT = re.compile(r"\s+(?=[\[(])")


class Row(NamedTuple):
    """One row of a text: its number, counted from 1, and its line."""

    number: int
    line: str


@dataclass(frozen=True)
class Dialect:
    """How to cut the rows of one file into cells, and the cells into numbers."""

    delimiter: str
    """One character; a blank stands for any run of blanks and tabs."""
    decimal: str
    names: tuple[str, ...]
    """The header; empty where the file has none."""
    header_row: int
    """Number of the row that holds the header, 0 where there is none."""
    width: int
    """Cells per row; empty cells beyond it are passed over."""


@dataclass(frozen=True)
class _Trial:
    delimiter: str
    decimal: str
    even: float
    """Share of rows that have the commonest number of cells."""
    numeric: float
    """Share of cells of those rows that hold a number or nothing."""
    several: bool
    fitting_header: bool

    @property
    def score(self) -> tuple[float, bool]:
        """A first row of another length than the others counts three quarters."""
        fits = 1.0 if self.fitting_header else 0.75
        return fits * self.even * self.numeric, self.several


_PERFECT = (1.0, True)
"""The score of rows of equal length that hold nothing but numbers."""


def cut(line: str, delimiter: str) -> list[str]:
    """The cells of one line, without quotes and surrounding blanks; csv.Error for bad quotes."""
    if '"' in line:
        if delimiter == WHITESPACE:
            line = line.strip().replace("\t", " ")
        row = csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
        return [cell.strip() for cell in next(row)]
    if delimiter == WHITESPACE:
        # blanks beyond ASCII divide thousands
        return line.split() if line.isascii() else _RUN.split(line.strip(" \t\r\n"))
    return [cell.strip() for cell in line.split(delimiter)]


def recognise(rows: list[Row], name: str, layout: Layout, above: Sequence[Row] = ()) -> Dialect:
    """The dialect of a text from its first rows (those that hold data), as far as not stated.

    above: the comments above them, the nearest first, without their marks.
    Raises InputError when what is stated cannot be so, or when a first row of both text and
    numbers leaves open whether it is a header.
    """
    stated = _SPOKEN.get(layout.delimiter or "", layout.delimiter) or None
    _check_stated(stated, layout.decimal, name)
    marks, header = layout.decimal or ".,", layout.header

    def best_of(delimiters: Sequence[str]) -> _Trial:
        best = _try(rows, delimiters[0], marks[0])
        for delimiter, mark in [*product(delimiters, marks)][1:]:
            if best.score == _PERFECT:  # of equals the first is taken
                break
            best = max(best, _try(rows, delimiter, mark), key=lambda trial: trial.score)
        return best

    best = best_of([stated] if stated else DELIMITERS)
    if not best.several and stated:
        _check_fits(best, best_of(DELIMITERS), rows, name)
    cells = [_cells(row, best.delimiter, name) for row in rows]
    first = rows[0]
    if header is None:
        header = is_header(cells, best.decimal, f"{name}, row {first.number}")
    names = tuple(_without_empty_end(cells[0])) if header else ()
    if header:
        _check_header(names, [_without_empty_end(row) for row in cells[1:]], first, name)
    width = len(names) or _width(cells)
    open_ = layout.header is None and not header
    commented = _commented(above, best, width) if open_ else None
    if commented is not None:
        number, names = commented
        return Dialect(best.delimiter, best.decimal, names, number, width)
    return Dialect(best.delimiter, best.decimal, names, first.number if names else 0, width)


def _commented(
    above: Sequence[Row], best: _Trial, width: int
) -> tuple[int, tuple[str, ...]] | None:
    """The row and the names of a comment that names every column once; None without such a one."""
    for row in above if width >= _FEWEST else ():
        for delimiter in dict.fromkeys((best.delimiter, *DELIMITERS)):
            line = _BEFORE_UNIT.sub("", row.line) if delimiter == WHITESPACE else row.line
            try:
                names = _without_empty_end(cut(line, delimiter))
            except csv.Error:
                continue
            if names and not names[0]:  # "#,x,y": the mark is a name, or stands before the names
                names = ["#", *names[1:]][len(names) > width :]
            numeric = any(is_number(name, best.decimal) for name in names)
            if len({*names, ""}) == width + 1 == len(names) + 1 and not numeric:
                return row.number, tuple(names)
    return None


def _check_stated(delimiter: str | None, decimal: str | None, name: str) -> None:
    if delimiter is not None and (len(delimiter) != 1 or delimiter.isalnum() or delimiter in '"\n'):
        raise InputError(
            f"{delimiter!r} is not a delimiter",
            code="invalid-value",
            place=name,
            remedy="state one character: , ; tab ...",
        )
    if decimal not in (None, ".", ","):
        raise InputError(
            f"{decimal!r} is not a decimal mark",
            code="invalid-value",
            place=name,
            remedy="state a point or a comma",
        )


def _check_fits(stated: _Trial, best: _Trial, rows: list[Row], name: str) -> None:
    if not stated.several and best.several and best.even * best.numeric > 0.3:
        raise InputError(
            f"the delimiter is stated as {spoken(stated.delimiter)}, which does not divide this "
            f"row: {rows[0].line.strip()[:60]!r}",
            code="invalid-syntax",
            place=f"{name}, row {rows[0].number}",
            remedy=f"state {spoken(best.delimiter)}, or leave the delimiter out",
        )


def spoken(delimiter: str) -> str:
    """A delimiter as messages call it."""
    return _WORDS.get(delimiter, repr(delimiter))


def _says_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, with its unit or without, or blank."""
    if is_number(cell, decimal) or is_missing(cell):
        return True
    unit = _UNIT_BEHIND.search(cell, max(len(cell) - _LONGEST_UNIT, 0))
    return (
        unit is not None
        and not is_missing(unit["unit"])
        and is_number(cell[: unit.start()], decimal)
    )


def _try(rows: list[Row], delimiter: str, decimal: str) -> _Trial:
    try:
        cells = [_without_last_empty(cut(row.line, delimiter)) for row in rows]
    except csv.Error:
        return _Trial(delimiter, decimal, 0.0, 0.0, False, False)
    body = cells[1:] or cells
    lengths = [len(row) for row in body]
    width = max(set(lengths), key=lambda n: (lengths.count(n), n == len(cells[0]), n))
    even = [row for row in body if len(row) == width]
    good = sum(_says_number(cell, decimal) for row in even for cell in row)
    return _Trial(
        delimiter,
        decimal,
        len(even) / len(body),
        good / (width * len(even)),
        width > 1,
        len(cells[0]) == width,
    )


def _cells(row: Row, delimiter: str, name: str) -> list[str]:
    try:
        return cut(row.line, delimiter)
    except csv.Error:
        raise quote_error(name, row) from None


def quote_error(name: str, row: Row) -> InputError:
    """The error for a quote that does not end on its line."""
    return InputError(
        f"a quoted cell does not end: {row.line.strip()[:60]!r}",
        code="invalid-syntax",
        place=f"{name}, row {row.number}",
        remedy="close the quotes on the same line, or remove them",
    )


def is_header(cells: Sequence[Sequence[object]], decimal: str, place: str) -> bool:
    """Whether the first of these rows is a header.

    A header holds no number, and names more columns than it marks as missing; a row of data holds
    text only where the next one does too. Raises InputError where neither is so.
    """
    numeric = [is_number(cell, decimal) for cell in cells[0]]
    text = [i for i, c in enumerate(cells[0]) if not numeric[i] and not is_missing(c)]
    if not any(numeric):
        marked = [c for c in cells[0] if is_missing(c) and str(c).strip()]
        return len(text) > len(marked)
    below = cells[1] if len(cells) > 1 else cells[0]
    if all(i < len(below) and not is_number(below[i], decimal) for i in text):
        return False
    raise InputError(
        f"this row holds both numbers and text ({str(cells[0][text[0]])[:60]!r}): header or data?",
        code="invalid-syntax",
        place=f"{place}, column {text[0] + 1}",
        remedy="state header = true or header = false, or correct the cell",
    )


def only_header(place: str) -> InputError:
    """The error for a table of which only the header is there."""
    return InputError(
        "there is a header, but no row of data",
        code="no-data",
        place=place,
        remedy="give one row per pose; if the row is data, state header = false",
    )


def _check_header(names: tuple[str, ...], body: list[list[str]], row: Row, name: str) -> None:
    if body and all(len(cells) > len(names) for cells in body):
        raise InputError(
            f"the header names {len(names)} columns ({row.line.strip()[:60]!r}), the rows below "
            f"it have {len(body[0])}",
            code="invalid-syntax",
            place=f"{name}, row {row.number}",
            remedy="name every column, comment out lines without data with #, or state the "
            "delimiter",
        )


def _width(cells: list[list[str]]) -> int:
    """The commonest number of cells of a row, less those that are empty in all such rows."""
    lengths = [len(row) for row in cells]
    width = max(set(lengths), key=lambda length: (lengths.count(length), length))
    even = [row for row in cells if len(row) == width]
    while width > 1 and not any(row[width - 1] for row in even):
        width -= 1
    return width


def _without_empty_end(row: list[str]) -> list[str]:
    end = len(row)
    while end > 1 and not row[end - 1]:
        end -= 1
    return row[:end]


def _without_last_empty(row: list[str]) -> list[str]:
    return row[:-1] if len(row) > 1 and not row[-1] else row


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
            comments.append(Row(number, line.lstrip("#%").strip(" ")))
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
