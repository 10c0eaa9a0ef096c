"""A Parquet file, or a folder of them, as a table; only columns and rows asked for are kept.

Before a file is read here, the guarded child has read what its end says of it, and then each
column asked for, to the last row. What it gets through, this process can read, again and again.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.tables.cells import ids
from loopcal.files.tables.isolated import from_child
from loopcal.files.tables.raw import empty, existing_file, sha256_of, unreadable
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import ROW, Table, find_column, positions_of

if TYPE_CHECKING:
    import polars as pl

BLOCK = 1 << 20
"""Rows read at once where few of them are kept."""
_CELLS, _CELLS_PER_BYTE = 1 << 24, 4
"""Cells that any file may state, and those per byte of it: equal readings take hardly any."""
_TEXT, _TEXT_PER_BYTE = 1 << 26, 8
"""Bytes that the texts of a column may unfold to, and those for each byte of the file."""


@dataclass(frozen=True)
class ParquetFile:
    """path: absolute; names: of its columns, in the order of the first file of a folder.

    mark: SHA-256 of the end of the file, where Parquet says what is in it.
    """

    path: Path
    rows: int
    names: tuple[str, ...]
    mark: str


def parquet_files(path: str | Path) -> tuple[ParquetFile, ...]:
    """The file, or the files of a folder by name; hidden ones are none of them.

    Raises InputError for what is no Parquet, for other columns, and for a folder without any.
    """
    path = Path(path)
    if not path.is_dir():
        return (_file(path),)
    try:
        paths = sorted(p for p in path.iterdir() if p.suffix.lower() in READER.endings)
    except OSError as error:
        raise unreadable(path, error) from None
    files = [_file(p) for p in paths if not p.name.startswith(".")]
    if not files:
        raise InputError(
            "this folder contains no Parquet file (subfolders are not read)",
            code="wrong-file-type",
            place=str(path),
            remedy="put *.parquet files there, or name a file",
        )
    for file in files[1:]:
        if set(file.names) != set(files[0].names):
            raise InputError(
                f"its columns are not those of {files[0].path.name}",
                code="unreadable-file",
                place=file.path.name,
                remedy="give all files of the folder the same columns",
            )
    return tuple(replace(file, names=files[0].names) for file in files)


def read_parquet(
    path: str | Path,
    layout: Layout = RECOGNISED,
    *,
    wanted: Collection[str | int] | None = None,
    every: int = 1,
    pose: str | int | None = None,
    also: Collection[str] = (),
) -> Table:
    """The columns wanted (all of them for None); null is missing, rows count from 1.

    Rows are the 1st, (every + 1)th, ... of the file, or of all files of a folder. Rows with
    the ids `also` in the column `pose` (their numbers for None) are read too. Raises InputError for
    what `parquet_files` refuses, a column that is not there or of several kinds, no rows.
    """
    path = Path(path)
    files = parquet_files(path)
    names, begins = files[0].names, begins_of(files)
    total = sum(file.rows for file in files)
    if not total:
        raise empty(path.name)
    positions = positions_of(wanted, names, path.name)
    column = None if pose in (None, ROW) else names[find_column(pose, names, len(names), path.name)]
    prove(files, {names[i] for i in positions} | ({column} if also and column else set()))
    frames: list[pl.DataFrame] = []
    kept: list[NDArray[np.int64]] = []
    for file in files:
        size = file.rows if every == 1 else BLOCK
        for offset in range(0, file.rows, size or 1):
            frame = frame_of(file, [names[i] for i in positions], offset, size)
            rows = begins[file.path.name] + offset + np.arange(len(frame), dtype=np.int64)
            keep = rows % every == 0
            if also:
                row_ids = map(str, (rows + 1).tolist()) if column is None else ids(frame[column])
                keep |= np.array([i in also for i in row_ids])
            frames.append(frame if keep.all() else frame.filter(keep))
            kept.append(rows[keep] + 1)
    return Table(
        path.name,
        None,
        sha256_of_all([sha256_of(file.path) for file in files]),
        names,
        dict(zip(positions, _together(frames, path.name).get_columns(), strict=True)),
        np.concatenate(kept),
        total=total,
        begins=begins if len(files) > 1 else {},
    )


def begins_of(files: Sequence[ParquetFile]) -> dict[str, int]:
    """The name of each file of a folder, and how many rows those before it have."""
    begins = np.cumsum([0, *(file.rows for file in files)]).tolist()
    return dict(zip((file.path.name for file in files), begins, strict=False))


def sha256_of_all(digests: Sequence[str]) -> str:
    """Of one file its own, of several that of the list of their own."""
    return digests[0] if len(digests) == 1 else sha256("\n".join(digests).encode()).hexdigest()


def mark_of(path: Path) -> str:
    """A Parquet file ends in where its columns lie, their extremes, and the length of all that."""
    with path.open("rb") as file:
        # The last 8 bytes of the format: the length of the description ahead of them, and PAR1.
        file.seek(-8, 2)
        length = int.from_bytes(file.read(4), "little")
        file.seek(-8 - length, 2)
        return sha256(file.read()).hexdigest()


def prove(files: Iterable[ParquetFile], names: Iterable[str]) -> None:
    """Raise InputError where a column of a file cannot be read to its last row."""
    for file in files:
        _prove(file, tuple(sorted(names)))


# The mark of a file is part of the key: a file that was replaced is proved again.
@lru_cache(maxsize=4096)
def _prove(file: ParquetFile, names: tuple[str, ...]) -> None:
    arguments = {"path": str(file.path), "names": names, "rows": file.rows}
    from_child(f"{__name__}:read_through", arguments, file.path, "Parquet")


def _file(path: Path) -> ParquetFile:
    path = existing_file(path).absolute()
    description = json.loads(
        from_child(f"{__name__}:described", {"path": str(path)}, path, "Parquet")
    )
    return ParquetFile(path, description["rows"], tuple(description["names"]), mark_of(path))


def described(path: str) -> bytes:
    """Rows and columns of a file, as JSON; runs in the child."""
    import polars as pl

    rows = pl.scan_parquet(path, glob=False).select(pl.len()).collect().item()
    names = [*pl.read_parquet_schema(path)]
    if rows * len(names) > _CELLS + _CELLS_PER_BYTE * Path(path).stat().st_size:
        raise ValueError(
            f"it states {rows} rows of {len(names)} columns, far more than it can hold"
        )
    return json.dumps({"rows": rows, "names": names}).encode()


def read_through(path: str, names: Sequence[str], rows: int) -> bytes:
    """Read columns of a file block by block and forget them; runs in the child."""
    import polars as pl

    text = dict.fromkeys(names, 0)
    most = _TEXT + _TEXT_PER_BYTE * Path(path).stat().st_size
    for offset in range(0, rows, BLOCK):
        frame = pl.scan_parquet(path, glob=False).select(names).slice(offset, BLOCK).collect()
        for column in frame.iter_columns():
            if not (column.dtype.is_numeric() or column.dtype.is_temporal()):
                text[column.name] += _unfolded(column)
                if text[column.name] > most:
                    raise ValueError(
                        f"the column {column.name!r} unfolds to more than {most / 1e9:.1g} GB"
                    )
    return b""


def _unfolded(column: pl.Series) -> int:
    """Bytes of what is no number: equal texts lie in a file, and in a frame, only once."""
    import polars as pl

    if column.dtype == pl.String:
        return int(column.str.len_bytes().sum())
    if column.dtype in (pl.Boolean, pl.Null):
        return len(column)
    return int(column.estimated_size())


def frame_of(file: ParquetFile, names: Sequence[str], offset: int, rows: int) -> pl.DataFrame:
    """Some rows and columns of a file.

    Raises InputError where it cannot be read any more, or is not the one it was.
    """
    import polars as pl

    try:
        # Compared before reading: rows of a file that was replaced would mix two data sets.
        same = mark_of(file.path) == file.mark
        # glob=False: brackets in the name of a file are no pattern.
        frame = pl.scan_parquet(file.path, glob=False).select(names if same else [])
        if same:
            return frame.slice(offset, rows).collect()
        what = "changed while it was read"
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        what = f"cannot be read ({getattr(error, 'strerror', None) or str(error).splitlines()[0]})"
    raise InputError(
        f"this file {what} on host {platform.node()!r}",
        code="unreadable-file",
        place=str(file.path),
        remedy="do not change readings during a run; on a cluster, every host needs the file at "
        "this path",
    )


def _together(frames: Sequence[pl.DataFrame], place: str) -> pl.DataFrame:
    """Frames with the same columns as one; numbers of several types as one that holds them all."""
    import polars as pl

    for name in frames[0].columns:
        kinds = {frame[name].dtype for frame in frames} - {pl.Null()}
        if len(kinds) > 1 and not all(kind.is_numeric() for kind in kinds):
            raise InputError(
                f"the column {name!r} is {' and '.join(sorted(map(str, kinds)))}",
                code="invalid-number",
                place=place,
                remedy="write it as the same type in all files of the folder",
            )
    return frames[0] if len(frames) == 1 else pl.concat(frames, how="vertical_relaxed")


READER = Reader(
    "Parquet",
    "a file, or a folder of files with the same columns; large ones in chunks",
    (".parquet", ".pq"),
    read_parquet,
    guarded=False,
)
