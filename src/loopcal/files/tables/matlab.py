"""Variables of a MATLAB file (format 4 to 7, not 7.3) as a table.

Three habits are read: a numeric matrix, its columns by number; vectors and matrices by their names;
a struct whose fields are such, also structs in it or beside others, or an array of structs with
numbers or a text per field.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError, unknown_name
from loopcal.files.tables.arrays import columns_of, refuse_rivals, rows_of
from loopcal.files.tables.cells import Cells
from loopcal.files.tables.raw import existing_file, sha256_of
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table, positions_of
from loopcal.files.tables.unfolded import refuse_large_matlab
from loopcal.measurements.source import file_name


def read_matlab(
    path: str | Path,
    layout: Layout = RECOGNISED,
    *,
    wanted: Collection[str | int] | None = None,
) -> Table:
    """The variable stated; else the only one there is; else all of one length, by their names.

    Of vectors and fields only those wanted (all for None) must be of equal length. Raises
    InputError for format 7.3, a broken file, a variable that is not there or is no table.
    """
    path = existing_file(path)
    variables, variable = _load(path), layout.variable
    if variable is not None and variable not in variables:
        raise unknown_name(f"there is no variable {variable!r}", variable, variables, path.name)
    chosen = variable or (next(iter(variables)) if len(variables) == 1 else None)
    if chosen is None:
        return _from_arrays(_flat(variables), path, None, wanted)
    value, part = variables[chosen], f"variable {chosen!r}"
    name = file_name(path.name, part)
    if value.dtype.names:
        return _from_arrays(_fields(value, name), path, part, wanted)
    if value.ndim != 2 or value.size == 0:
        raise InputError(
            f"its shape is {_shape(value)}",
            code="wrong-shape",
            place=name,
            remedy="name a matrix with a row per pose",
        )
    # MATLAB has no vectors: one row of numbers is one reading for each pose.
    matrix = value.reshape(-1, 1) if value.shape[0] == 1 else value
    cells = {i: _cells(matrix[:, i], name) for i in range(matrix.shape[1])}
    rows = np.arange(1, len(matrix) + 1, dtype=np.int64)
    return Table(path.name, part, sha256_of(path), (), cells, rows)


def _load(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise InputError(
            "this is a MATLAB 7.3 file (HDF5), which is not supported",
            code="wrong-file-type",
            place=path.name,
            remedy="save it in MATLAB with save(name, '-v7')",
        )
    from scipy.io import loadmat

    refuse_large_matlab(path)
    contents = loadmat(path, chars_as_strings=True)
    variables = {
        n: v for n, v in contents.items() if not n.startswith("__") and isinstance(v, np.ndarray)
    }
    # A single text describes the file and is no column.
    variables = {n: v for n, v in variables.items() if v.dtype.kind != "U" or v.size > 1}
    if not variables:
        raise InputError(
            "it holds no arrays",
            code="wrong-file-type",
            place=path.name,
            remedy="save a matrix or vectors in it",
        )
    return variables


def _fields(value: Any, name: str) -> dict[str, Any]:
    """The columns of a struct of vectors, or of an array of structs with one entry per field, or
    equally many numbers."""
    if value.size == 1:
        return _flat(_entries(value))
    columns = {}
    for field in value.dtype.names:
        entries = [np.asarray(entry) for entry in value[field].ravel()]
        sizes = {entry.size for entry in entries}
        if max(sizes) > 1 and len(sizes) == 1 and entries[0].dtype.kind in "fiu":
            columns[field] = np.stack([np.squeeze(entry) for entry in entries])
            continue
        if max(sizes) > 1:
            raise InputError(
                f"field {field!r} has several numbers in some structs",
                code="invalid-number",
                place=name,
                remedy="give each struct equally many",
            )
        columns[field] = np.array(
            [entry.ravel()[0] if entry.size else None for entry in entries], dtype=object
        )
    return columns


def _entries(value: Any) -> dict[str, Any]:
    """The fields of one struct."""
    return {field: np.atleast_1d(value[field].item()) for field in value.dtype.names}


def _flat(arrays: dict[str, Any]) -> dict[str, Any]:
    """With the fields of each single struct in its place, such as robot.q."""
    made: dict[str, Any] = {}
    for name, value in arrays.items():
        if value.dtype.names and value.size == 1:
            made |= _flat({f"{name}.{field}": one for field, one in _entries(value).items()})
        else:
            made[name] = value
    return made


def _from_arrays(
    arrays: dict[str, Any], path: Path, part: str | None, wanted: Collection[str | int] | None
) -> Table:
    """Vectors by their names, beside the columns of matrices that are as long."""
    name = file_name(path.name, part)
    vectors = {n: v.ravel() for n, v in arrays.items() if v.size > 1 and v.size in v.shape}
    matrices = {n: v for n, v in arrays.items() if v.dtype.kind in "fiu" and n not in vectors}
    count = rows_of(vectors or matrices)
    remedy = (
        "name the variable with the readings (variable = ... in a project, --sheet of init), one "
        f"of {_listed(arrays)}"
    )
    refuse_rivals(matrices, count, name, remedy)
    columns = {**vectors, **(columns_of(matrices, count) if count > 1 else {})}
    if not columns:
        raise InputError(
            f"none of its {len(arrays)} variables is a vector or a matrix",
            code="wrong-file-type",
            place=path.name,
            remedy=remedy,
        )
    names = tuple(columns)
    positions = positions_of(wanted, names, name)
    taken = {i: columns[names[i]] for i in positions}
    lengths = {names[i]: len(vector) for i, vector in taken.items()}
    if len(set(lengths.values())) != 1:
        few = ", ".join(f"{n} has {length}" for n, length in [*lengths.items()][:5])
        raise InputError(
            f"the vectors differ in length: {few}",
            code="wrong-shape",
            place=name,
            remedy="ask only for columns of one length, or state variable = ...",
        )
    rows = np.arange(1, next(iter(lengths.values())) + 1, dtype=np.int64)
    cells = {i: _cells(vector, name) for i, vector in taken.items()}
    return Table(path.name, part, sha256_of(path), names, cells, rows)


def _cells(vector: Any, name: str) -> Cells:
    """The entries of one vector: numbers as such, texts and cell arrays as a list."""
    if vector.dtype.kind in "fiu":
        return np.asarray(vector, dtype=np.float64)
    if vector.dtype.kind in "UO":
        entries = [v.item() if isinstance(v, np.ndarray) and v.size == 1 else v for v in vector]
        return ["" if isinstance(v, np.ndarray) else v for v in entries]
    raise InputError(
        f"it holds {vector.dtype.name} values, not real numbers",
        code="invalid-number",
        place=name,
        remedy="save real numbers (double)",
    )


def _shape(value: Any) -> str:
    return "×".join(map(str, value.shape))


def _listed(variables: dict[str, Any]) -> str:
    few = ", ".join(f"{name} ({_shape(value)})" for name, value in [*variables.items()][:10])
    return few + (f" and {len(variables) - 10} more" if len(variables) > 10 else "")


READER = Reader(
    "MATLAB",
    "format 4 to 7: a matrix, or vectors and matrices by their names, also in a struct",
    (".mat",),
    read_matlab,
    ("variable", "spread"),
    part="variable",
)
