"""Tables with one row for each point of an image, spread to one row for each pose.

    pose, camera, board, point, u, v        pose, 1:board:0:u, 1:board:0:v, 1:board:1:u, ...

The labels of a row make the name of its readings; a point that was not seen is missing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.tables.cells import Cells
from loopcal.files.tables.table import Table
from loopcal.mechanisms.instruments.camera import PIXEL

Index = NDArray[np.intp]
LABELS = ("camera", "board", "point")
MOST = 1 << 26
"""Cells of the table that is made: half a gigabyte."""


def spread_rows(table: Table, columns: Mapping[str, str]) -> Table:
    """The table with one row for each pose; columns: which of it is pose, label, u and v.

    Raises InputError for a point that stands twice in one pose, and for a table that would be
    too large.
    """
    pose = table.ids(table.position(columns["pose"]))
    labels = [table.labels(table.position(columns[key])) for key in LABELS if key in columns]
    named = [":".join(row) for row in zip(*labels, strict=True)]
    poses, names = list(dict.fromkeys(pose)), list(dict.fromkeys(named))
    if len(poses) * len(names) * len(PIXEL) > MOST:
        raise InputError(
            f"{len(poses)} poses with {len(names)} different points are too large a table",
            code="too-large",
            place=table.name,
            remedy="check the columns of pose and point; give fewer poses",
        )
    row = {name: i for i, name in enumerate(poses)}
    place = {name: i for i, name in enumerate(names)}
    rows = np.array([row[name] for name in pose], dtype=np.intp)
    points = np.array([place[name] for name in named], dtype=np.intp)
    _refuse_repeated(table, rows, points, named, pose)
    cells: dict[int, Cells] = {0: poses}
    headers = [columns["pose"]]
    keep = np.arange(len(pose), dtype=np.int64)
    wide = []
    for axis in PIXEL:
        filled = np.full((len(names), len(poses)), np.nan)
        filled[points, rows] = table.numbers(table.position(columns[axis]), keep)
        wide.append(filled)
    for name, *values in zip(names, *wide, strict=True):
        for axis, value in zip(PIXEL, values, strict=True):
            cells[len(headers)] = value
            headers.append(f"{name}:{axis}")
    first = np.full(len(poses), -1, dtype=np.int64)
    first[rows[::-1]] = table.rows[::-1]
    return Table(table.file, table.part, table.sha256, tuple(headers), cells, first, decimal=".")


def _refuse_repeated(
    table: Table, rows: Index, points: Index, named: list[str], pose: tuple[str, ...]
) -> None:
    code = rows * (int(points.max(initial=0)) + 1) + points
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    if (count > 1).any():
        index = int(first[count > 1][0])
        again = int(np.flatnonzero(code == code[index])[1])
        raise InputError(
            f"the point {named[index]} stands twice in pose {pose[index]}",
            code="duplicate-name",
            place=table.place(again),
            remedy="keep one of them",
        )
