"""A table with a column per pose or joint, the first naming them: its rows become columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loopcal.files.recognition.joint_sets import names_joints
from loopcal.files.tables.cells import is_number
from loopcal.files.tables.table import Table

_FEWEST = 4
"""Rows that name a quantity, at least."""
_ROWS = 3
"""Such rows for each column beside them, at most: names of points have three coordinates each."""


def matrices_unfolded(table: Table) -> tuple[Table, str]:
    """A table of 4x4 matrices below each other with a row for each, and what to say of it, "" where
    it holds none: every fourth row is 0, 0, 0, 1."""
    count, four = len(table.rows), [0, 1, 2, 3]
    if sorted(table.columns) != four or [*table.numeric()] != four or count % 4:
        return table, ""
    cells = np.array([table.numbers(i, np.arange(count)) for i in range(4)]).T
    if not (cells[3::4] == np.eye(4)[3]).all():
        return table, ""
    rows = cells.reshape(-1, 16)
    names = tuple(f"T{i}{j}" for i in range(1, 5) for j in range(1, 5))
    columns = dict(enumerate(rows.T))
    numbers = np.arange(1, len(rows) + 1, dtype=np.int64)
    made = replace(table, names=names, columns=columns, rows=numbers)
    return made, f"{table.name} holds {len(rows)} matrices of four rows: one for each pose."


def turned_over(
    table: Table, names: Callable[[Sequence[str]], bool] = names_joints
) -> tuple[Table, str]:
    """The table with a row per pose, and what to say of it, "" where it has one already.

    The words of the first column are names of this kind, and the header has none.
    """
    width = 1 + max(table.columns, default=-1)
    if any(not isinstance(c, list | np.ndarray) for c in table.columns.values()) or width < 2:
        return table, ""
    rows = list(zip(*(table.columns[i] for i in range(width)), strict=True))
    named = [row for row in rows if str(row[0] or "").strip() and is_number(row[1], table.decimal)]
    words = [str(row[0]).strip() for row in named]
    if not _FEWEST <= len(named) <= _ROWS * (width - 1):
        return table, ""
    if len(named) < len(rows) - 1 or len({*words}) < len(words):
        return table, ""
    if not names(words) or names(table.names):
        return table, ""
    ids = [str(name) or str(i) for i, name in enumerate(table.names[1:width], 1)]
    columns = {0: ids or [*map(str, range(1, width))]}
    columns |= {i: [*row[1:]] for i, row in enumerate(named, 1)}
    made = replace(
        table,
        names=("pose", *words),
        columns=columns,
        rows=np.arange(1, width, dtype=np.int64),
    )
    return made, f"{table.name} has a column per pose: its rows are read as columns."
