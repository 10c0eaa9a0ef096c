"""Cells that hold their unit: `12.5°`, `1,234.5 mm`, `48° 12' 30.5"`. It moves into the header."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from loopcal.errors import listed
from loopcal.files.recognition.headers import heading
from loopcal.files.tables.cells import is_missing, is_number, number
from loopcal.files.tables.table import Table

_WITH_UNIT = re.compile(
    r"(?P<number>[-+]?[\d.,]{1,40}(?:[eE][-+]?\d{1,4})?)\s{0,3}(?P<unit>\D{1,12})"
)
_ARC = re.compile(
    r"(?P<sign>[-+]?)(?P<deg>\d{1,4})\s?[°d:]\s?(?P<min>\d{1,2})\s?['′’m:]\s?"
    r"(?P<sec>\d{1,2}(?:[.,]\d{0,9})?)\s?(?:[\"″”s]|'')?"
)


def with_units_in_names(table: Table) -> tuple[Table, str]:
    """The table with the units of cells in its header, and what to say of it, "" for none.

    A column is read so where each of its cells has the same unit.
    """
    columns, names = {**table.columns}, [*table.names]
    names += [""] * (1 + max(columns, default=-1) - len(names))
    moved = []
    for i, cells in table.columns.items():
        if isinstance(cells, list) and (made := _numbers(cells, table.decimal, names[i])):
            columns[i], unit = made
            names[i] = f"{names[i] or f'column {i + 1}'} [{unit}]"
            moved.append(names[i])
    if not moved:
        return table, ""
    made_table = replace(table, names=tuple(names), columns=columns)
    return made_table, f"The cells of {table.name} hold units: {listed(moved)} are read so."


def _numbers(cells: Sequence[object], decimal: str, name: str) -> tuple[list[object], str] | None:
    """The numbers of cells with one unit, and the unit; None for others."""
    first = next((cell for cell in cells if not is_missing(cell)), None)
    if first is None or is_number(first, decimal):
        return None
    present = [str(cell).strip() for cell in cells if not is_missing(cell)]
    # 10:15:30 is a time of day; with a ° it is an angle, whatever stands between its parts
    if all(_ARC.fullmatch(cell) for cell in present) and ("°" in present[0] or "'" in present[0]):
        return [_degrees(str(cell)) if not is_missing(cell) else None for cell in cells], "deg"
    made: list[object] = []
    units = set()
    for cell in cells:
        match = _WITH_UNIT.fullmatch(str(cell).strip())
        if is_missing(cell):
            made.append(None)
        elif match and is_number(match["number"], decimal):
            made.append(number(match["number"], decimal))
            units.add(heading(f"x [{match['unit']}]").unit)
        else:
            return None
    unit = units.pop() if len(units) == 1 else None
    stated = heading(name).unit if name else None
    return (made, unit) if unit and stated in (None, unit) else None


def _degrees(cell: str) -> float:
    match = _ARC.fullmatch(cell.strip())
    assert match
    size = int(match["deg"]) + int(match["min"]) / 60 + float(match["sec"].replace(",", ".")) / 3600
    return -size if match["sign"] == "-" else size
