"""The files of readings as they stand: their columns, and the cells that are no numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from loopcal.errors import LoopcalError
from loopcal.files.project.data_table import FileTable
from loopcal.files.project.project_file import Project
from loopcal.files.tables.cells import Cells, is_missing, is_number
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table

MOST = 200
"""Bad cells that are listed."""


@dataclass(frozen=True)
class BadCell:
    """A cell that is no number; row: in the file; pose: its id; text: what it says."""

    file: str
    row: int
    pose: str
    column: str
    text: str


def columns(project: Project) -> list[str]:
    """Names of the columns of all files of readings."""
    return list(dict.fromkeys(name for table, _ in _tables(project) for name in table.names))


def bad_cells(project: Project) -> list[BadCell]:
    """Cells of the columns in use that hold something else than a number, row by row.

    Blank cells, which stand for what was not measured, and poses left out are none.
    """
    cells = []
    for table, spec in _tables(project):
        pose, out = spec.options.get("pose"), {str(p) for p in spec.options.get("exclude", ())}
        try:
            ids = table.ids(-1 if pose is None else table.position(pose))
            used = {table.position(column.column) for column in spec.columns.values()}
        except LoopcalError:
            continue
        for at in sorted(used - {-1}):
            for i, text in _wrong(table.columns[at], table.decimal):
                if ids[i] not in out:
                    row = int(table.rows[i])
                    cells.append(BadCell(table.file, row, ids[i], table.label(at), text))
    return sorted(cells, key=lambda cell: (cell.file, cell.row))[:MOST]


def _wrong(cells: Cells, decimal: str) -> Iterator[tuple[int, str]]:
    for i, cell in enumerate(cells):
        # NaN alone differs from itself.
        if not is_missing(cell) and cell == cell and not is_number(cell, decimal):
            yield i, str(cell)


def _tables(project: Project) -> Iterator[tuple[Table, FileTable]]:
    """The files that can be read, and how the project reads them."""
    for spec in () if project.data is None else project.data.parts:
        try:
            yield read_table(project.folder / spec.file, **spec.keywords), spec
        except LoopcalError:
            continue
