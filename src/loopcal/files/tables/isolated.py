"""Tables that others' code reads, read in the guarded child and handed back."""

from __future__ import annotations

import json
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.files.guarded import Stopped, guarded
from loopcal.files.tables.raw import existing_file
from loopcal.files.tables.reader import Layout, Reader
from loopcal.files.tables.table import Table

_RECOVERED = {
    "ROS bag": "recover it: mcap recover FILE -o NEW, ros2 bag reindex FOLDER, rosbag reindex FILE"
}
"""Kind of file -> what to do where it is damaged, beside writing it again."""


def read_isolated(
    reader: Reader, path: str | Path, layout: Layout, *, wanted: Collection[str | int] | None
) -> Table:
    """The table of a file by its reader, at least the columns wanted.

    Raises InputError as the reader does, and for a file that the reader cannot cope with.
    """
    path = Path(path) if reader.in_folder and Path(path).is_dir() else existing_file(path)
    arguments = {
        "reader": f"{reader.read.__module__}:{reader.read.__qualname__}",
        # Absolute: the child stays in the folder where it was started.
        "path": str(path.absolute()),
        "layout": layout.keywords,
        "wanted": None if wanted is None else [*wanted],
    }
    return unpacked(from_child(f"{__name__}:packed_table", arguments, path, reader.kind))


def from_child(function: str, arguments: dict[str, Any], path: Path, kind: str) -> bytes:
    """What the guarded child makes of a file; InputError, naming it, where it cannot be read."""
    try:
        return guarded(function, arguments, sum(one.stat().st_size for one in files_of(path)))
    except Stopped as why:
        raise InputError(
            f"this {kind} file cannot be read ({why})",
            code="wrong-file-type",
            place=path.name,
            remedy=_RECOVERED.get(kind, "write the file again, or save its table as CSV"),
        ) from None


def files_of(path: Path) -> list[Path]:
    """The file, or the files of a folder by name."""
    return sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]


def packed_table(
    reader: str, path: str, layout: dict[str, Any], wanted: list[str | int] | None
) -> bytes:
    """The table that a reader makes of a file, as bytes for `unpacked`; runs in the child."""
    module, name = reader.split(":")
    read = getattr(import_module(module), name)
    return packed(read(path, Layout(**layout), wanted=wanted))


def packed(table: Table) -> bytes:
    """A table as bytes: a line of JSON, then its rows and columns of numbers, 8 bytes each."""
    columns = {i: _compact(cells) for i, cells in table.columns.items()}
    head = {
        "file": table.file,
        "part": table.part,
        "sha256": table.sha256,
        "names": table.names,
        "decimal": table.decimal,
        "columns": [
            [i, None if isinstance(cells, np.ndarray) else cells] for i, cells in columns.items()
        ],
    }
    numbers = [c for c in columns.values() if isinstance(c, np.ndarray)]
    parts = [table.rows.astype("<i8"), *(c.astype("<f8") for c in numbers)]
    return b"\n".join([json.dumps(head, default=_plain).encode(), b"".join(map(bytes, parts))])


def unpacked(content: bytes) -> Table:
    """The table out of its bytes."""
    end = content.index(b"\n")
    head = json.loads(content[:end])
    kept = sum(cells is None for _, cells in head["columns"])
    body = content[end + 1 :]
    length = len(body) // 8 // (kept + 1)
    blocks = iter(np.frombuffer(body, "<f8").reshape(kept + 1, length))
    # Row numbers have 8 bytes too: the same bytes, viewed as whole numbers.
    rows = next(blocks).view("<i8")
    return Table(
        head["file"],
        head["part"],
        head["sha256"],
        tuple(head["names"]),
        {i: next(blocks) if cells is None else cells for i, cells in head["columns"]},
        rows,
        head["decimal"],
    )


def _plain(cell: Any) -> Any:
    """A cell of a type that JSON does not know: NumPy's numbers as such, dates as text."""
    return cell.item() if isinstance(cell, np.generic) else str(cell)


def _compact(cells: Any) -> Any:
    """A column of numbers alone as an array."""
    if isinstance(cells, list) and all(type(cell) is float for cell in cells):
        return np.array(cells)
    return cells
