"""Arrays by their names as a table: those of NumPy, and what other readers have of the kind.

The rows are the length that the arrays share. A matrix has a column for each of its others: three
are x, y and z, others are numbered from 1; of matrices per row `T` has T11, T12, ...
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.files.tables.raw import existing_file, sha256_of
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table
from loopcal.files.tables.unfolded import refuse_large_workbook


def by_columns(
    arrays: Mapping[str, Any],
    file: str,
    sha256: str,
    count: int,
    named: Sequence[str] = (),
) -> Table:
    """A table of so many rows; named: of the columns of arrays that are as wide."""
    columns = columns_of(arrays, count, named)
    cells = {i: np.asarray(v, dtype=np.float64) for i, v in enumerate(columns.values())}
    names = tuple(columns) if any(arrays) else ()
    return Table(file, None, sha256, names, cells, np.arange(1, count + 1, dtype=np.int64))


def rows_of(arrays: Mapping[str, Any]) -> int:
    """The length of most of the numbers, where each array is longest; the larger of two."""
    sizes: Counter[int] = Counter()
    for values in arrays.values():
        sizes[max(np.shape(values), default=1)] += np.size(values)
    return max(sizes, key=lambda n: (sizes[n], n), default=1)


def refuse_rivals(arrays: Mapping[str, Any], count: int, place: str, remedy: str) -> None:
    """Raise InputError where a matrix of another length has as many columns as one that is read."""
    wide = {min(v.shape): n for n, v in arrays.items() if v.ndim == 2 and count in v.shape}
    for name, values in arrays.items():
        if values.ndim == 2 and count not in values.shape and min(values.shape) in wide:
            raise InputError(
                f"{wide[min(values.shape)]} and {name} are alike, but differ in length",
                code="wrong-file-type",
                place=place,
                remedy=remedy,
            )


def columns_of(arrays: Mapping[str, Any], count: int, named: Sequence[str] = ()) -> dict[str, Any]:
    """Column -> (N,), of the arrays that have such a length; the others are left out."""
    made: dict[str, Any] = {}
    for name, values in arrays.items():
        values = np.asarray(values)
        values = values.reshape(1) if values.ndim == 0 else values
        if count not in values.shape:
            continue
        rows = np.moveaxis(values, values.shape.index(count), 0)
        rest = [size for size in rows.shape[1:] if size > 1]
        rows = rows.reshape(count, -1)
        for k, column in enumerate(rows.T):
            made[_name(name, k, rest, named)] = column
    return made


def _name(name: str, k: int, rest: Sequence[int], named: Sequence[str]) -> str:
    width = int(np.prod(rest, dtype=np.int64))
    if width == 1:
        return name
    if len(rest) == 2:
        return f"{name}{k // rest[1] + 1}{k % rest[1] + 1}"
    if len(named) == width:
        return f"{named[k]}.{name}"
    return f"{name} {'xyz'[k] if width == 3 else k + 1}".strip()


def read_arrays(path: str | Path, layout: Layout = RECOGNISED, *, wanted: object = None) -> Table:
    """The arrays of an .npz by their names, the one of an .npy by the numbers of its columns.

    Raises InputError for arrays of objects, for no numbers and for a file that is damaged.
    """
    path = existing_file(path)
    refuse_large_workbook(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            arrays = {"": loaded}
        else:
            with loaded:
                arrays = {name: loaded[name] for name in loaded.files}
    except (ValueError, OSError, EOFError, KeyError) as error:
        raise InputError(
            f"this NumPy file cannot be read ({error})",
            code="wrong-file-type",
            place=path.name,
            remedy="save arrays of numbers with numpy.save or numpy.savez",
        ) from None
    numbers = {n: v for n, v in arrays.items() if v.dtype.kind in "fiu" and v.size}
    if not numbers:
        raise InputError(
            "it holds no array of numbers",
            code="wrong-file-type",
            place=path.name,
            remedy="save arrays with a row per pose with numpy.savez",
        )
    only = np.atleast_1d(next(iter(numbers.values())))
    count = rows_of(numbers) if len(numbers) > 1 else len(only)
    refuse_rivals(numbers, count, path.name, "save only arrays with equally many rows in one file")
    return by_columns(numbers, path.name, sha256_of(path), count)


READER = Reader(
    "NumPy",
    "arrays with a row per pose, by their names",
    (".npy", ".npz"),
    read_arrays,
    ("spread",),
)
