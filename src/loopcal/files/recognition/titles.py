"""What stands in a table around its readings: titles above the header, summaries below the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.recognition.headers import stem
from loopcal.files.recognition.vocabulary import words
from loopcal.files.tables.cells import is_number
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.registry import TEXT, reader_of
from loopcal.files.tables.table import Table

_MOST, _FEWEST = 15, 4
"""Rows of titles at most, and columns of numbers that a table of readings has at least."""
_MOST_BYTES = 20_000_000
"""Of a text that is searched for titles: it is read once for each row that may be one."""
_SUMMARY = tuple(f"{word}_" for word in words("rows", "summary"))


def below_titles(path: Path, part: str | int | None) -> tuple[Table, str]:
    """The table of a file, and what to say of rows above its header.

    Raises the reader's InputError where the rows below hold no header either.
    """
    try:
        table = read_table(path, **({} if part is None else {reader_of(path).part: part}))
    except InputError:
        text_table = _text_below(path) if reader_of(path) is TEXT else None
        if text_table is None:
            raise
        return text_table
    return _cells_below(table)


def _text_below(path: Path) -> tuple[Table, str] | None:
    """The table that begins in one of the first lines; None where there is none."""
    if not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return None
    lines = path.read_bytes().split(b"\n")
    for count in range(1, min(_MOST, len(lines) - 2)):
        try:
            table = read_table(BytesIO(b"\n".join(lines[count:])))
        except InputError:
            continue
        named = [i for i in table.numeric() if i < len(table.names) and table.names[i]]
        if len(named) >= _FEWEST:
            return replace(table, file=path.name, rows=table.rows + count), _remark(
                path.name, count
            )
    return None


def _cells_below(table: Table) -> tuple[Table, str]:
    """The table, or what stands below the first row that names all columns of numbers."""
    if any(not isinstance(cells, list) for cells in table.columns.values()):
        return table, ""
    width = max(table.columns, default=-1) + 1
    names = [*table.names, *[""] * (width - len(table.names))]
    rows = list(zip(*(table.columns[i] for i in range(width)), strict=True))
    if not table.names or sum(map(bool, names)) >= max(_FEWEST, width - 1):
        return table, ""
    for count, row in enumerate(rows[:_MOST]):
        cells = ["" if cell is None else str(cell).strip() for cell in row]
        if sum(map(bool, cells)) >= max(_FEWEST, width - 1) and not any(map(is_number, row)):
            below = {i: list(cells[count + 1 :]) for i, cells in table.columns.items()}
            table_below = replace(
                table, names=tuple(cells), columns=below, rows=table.rows[count + 1 :]
            )
            return table_below, _remark(table.name, count + 1)
    return table, ""


def _remark(name: str, count: int) -> str:
    rows = "The first row" if count == 1 else f"The first {count} rows"
    return f"{rows} of {name} {'is a title' if count == 1 else 'are titles'}, not the header."


def readings_of(columns: Sequence[Sequence[str]], count: int) -> NDArray[np.intp]:
    """Positions of the rows that are no summary; columns: of text and ids, each (count,)."""
    last = count
    while last and any(f"{stem(cells[last - 1])}_".startswith(_SUMMARY) for cells in columns):
        last -= 1
    return np.arange(last)
