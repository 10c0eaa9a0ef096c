"""A table with a column per pose or joint, the first naming them: its rows become columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.headers import heading
from loopcal.files.recognition.joint_sets import usual_joints
from loopcal.files.tables.cells import is_number
from loopcal.files.tables.table import Table

_FEWEST = 4
"""Rows that name a quantity, at least."""
_ROWS = 3
"""Such rows for each column beside them, at most: names of points have three coordinates each."""


def names_joints(names: Sequence[str]) -> bool:
    """Whether some of these names are those of joints."""
    fields = [Field(0, i, heading(n), np.arange(2.0)) for i, n in enumerate(names) if n]
    return len(usual_joints(fields)) > 1


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
