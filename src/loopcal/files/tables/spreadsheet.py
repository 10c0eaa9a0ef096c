"""One sheet of an XLSX workbook as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.tables.cells import is_missing, is_number, may_be_grouped
from loopcal.files.tables.delimited import is_header, only_header
from loopcal.files.tables.raw import empty, existing_file, sha256_of
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table
from loopcal.files.tables.unfolded import refuse_large_workbook
from loopcal.measurements.source import file_name


def read_spreadsheet(
    path: str | Path, layout: Layout = RECOGNISED, *, wanted: object = None
) -> Table:
    """The cells of a sheet, by its name or its number from 1; the first sheet if not stated.

    Rows without any entry are passed over; cells of a formula have the value last computed.
    Raises InputError for a file that is no workbook, and for a sheet that is absent or empty.
    Raises it also for a first row that may or may not be a header.
    """
    import python_calamine

    path = existing_file(path)
    refuse_large_workbook(path)
    try:
        workbook = python_calamine.CalamineWorkbook.from_path(path)
        title = _title(workbook.sheet_names, layout.sheet, path.name)
        # Empty rows stay, so that messages count rows as the workbook does.
        sheet_rows = workbook.get_sheet_by_name(title).to_python(skip_empty_area=False)
    except python_calamine.CalamineError as error:
        raise InputError(
            f"this XLSX workbook cannot be read ({error})",
            code="wrong-file-type",
            place=path.name,
            remedy="save it again as XLSX or as CSV",
        ) from None
    part = f"sheet {title!r}"
    name = file_name(path.name, part)
    rows = [(i, row) for i, row in enumerate(sheet_rows, 1) if not all(map(is_missing, row))]
    if not rows:
        raise empty(name)
    mark, header = layout.decimal or _decimal_mark(rows), layout.header
    first = rows[0][1]
    if header is None:
        header = is_header([row for _, row in rows[:2]], mark, f"{name}, row {rows[0][0]}")
    if header and len(rows) == 1:
        raise only_header(f"{name}, row {rows[0][0]}")
    body = rows[1:] if header else rows
    return Table(
        path.name,
        part,
        sha256_of(path),
        tuple("" if is_missing(cell) else str(cell).strip() for cell in first) if header else (),
        {i: list(cells) for i, cells in enumerate(zip(*(row for _, row in body), strict=True))},
        np.array([i for i, _ in body], dtype=np.int64),
        mark,
    )


def _decimal_mark(rows: list[tuple[int, list[Any]]]) -> str:
    """That of numbers which are stored as text; cells of numbers have none."""
    texts = [cell for _, row in rows for cell in row if isinstance(cell, str)]
    by_point = any(is_number(text) and not is_number(text, ",") for text in texts)
    by_comma = any(
        is_number(text, ",") and not is_number(text) and not may_be_grouped(text, ".")
        for text in texts
    )
    return "," if by_comma and not by_point else "."


def _title(titles: list[str], sheet: str | int | None, name: str) -> str:
    if isinstance(sheet, str):
        if sheet not in titles:
            raise unknown_name(f"there is no sheet {sheet!r}", sheet, titles, name)
        return sheet
    number = 1 if sheet is None else sheet
    if not 1 <= number <= len(titles):
        raise InputError(
            f"there is no sheet {number}",
            code="unknown-name",
            place=name,
            remedy=f"give a number from 1 to {len(titles)}, or a name: {listed(titles)}",
        )
    return titles[number - 1]


READER = Reader(
    "XLSX",
    "one sheet of a workbook; of a formula the value last computed",
    (".xlsx", ".xlsm"),
    read_spreadsheet,
    ("sheet", "header", "decimal", "spread"),
    part="sheet",
    relatives=(".xls", ".xlsb", ".ods"),
)
