"""Readings of a Parquet file, or of a folder of them, that are read chunk by chunk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.streaming import Chunk
from loopcal.files.columns import Column, refuse_doubles, specified, wanted
from loopcal.files.dataset_readers import dataset_of
from loopcal.files.paths import expanded
from loopcal.files.place import Place
from loopcal.files.project_data import LoadedData, believed, columns_aside, loaded_from
from loopcal.files.project_file import Project
from loopcal.files.raw import sha256_of
from loopcal.files.table import Table, find_column
from loopcal.measurements.checks import DataWarning, check_dataset
from loopcal.measurements.dataset import checked_every
from loopcal.measurements.poses import pose_id
from loopcal.measurements.source import Source

LARGE = 2_000_000
"""Rows from which on a file is read in chunks unless the project says otherwise."""
CHUNK = 65_536
ENDINGS = (".parquet", ".pq")


@dataclass(frozen=True)
class _File:
    path: Path
    rows: int
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ParquetStream:
    """The poses of a project, in chunks of at most so many rows of one file."""

    project: Project
    files: tuple[_File, ...]
    name: str

    @cached_property
    def sha256(self) -> str:
        """Of the file, or of the list of all files' own."""
        own = [sha256_of(file.path) for file in self.files]
        return own[0] if len(own) == 1 else sha256("\n".join(own).encode()).hexdigest()

    @cached_property
    def poses(self) -> int:
        """How many there are after thinning and exclusion."""
        every, gone = self._every, self._excluded
        thinned = -(-sum(file.rows for file in self.files) // every)
        return thinned - sum(row % every == 0 for row in gone)

    @cached_property
    def warnings(self) -> tuple[DataWarning, ...]:
        """What looks odd about the first chunk; raises InputError as `check_dataset` does."""
        loaded = next(self._loaded())
        mechanism = self.project.mechanism
        return check_dataset(loaded.dataset, {**mechanism.quantities, **mechanism.known})

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, in order."""
        for loaded in self._loaded():
            yield Chunk(loaded.dataset, loaded.noise)

    def _loaded(self) -> Iterator[LoadedData]:
        spec = self.project.data
        assert spec is not None
        columns = specified({**spec.columns, **columns_aside(self.project)}, {})
        pose = spec.options["pose"]
        begin = 0
        for file in self.files:
            for offset in range(0, file.rows, CHUNK):
                table = _rows(file, offset, CHUNK, columns, pose)
                refuse_doubles(table, columns)
                number = np.arange(begin, begin + len(table.rows))
                begin += len(table.rows)
                used = number % self._every == 0
                used[[row - int(number[0]) for row in self._excluded if row in _span(number)]] = (
                    False
                )
                if not used.any():
                    continue
                ids = (
                    [str(i + 1) for i in number.tolist()]
                    if pose is None
                    else table.ids(table.position(pose))
                )
                source = Source(
                    self.name,
                    sha256=self.sha256,
                    rows_read=sum(f.rows for f in self.files),
                    excluded=tuple(map(pose_id, spec.options["exclude"])),
                    every=self._every,
                )
                read = dataset_of(table, columns, np.flatnonzero(used), ids, source)
                loaded = loaded_from(self.project, believed(spec, read))
                if len(self.files) > 1:
                    its = replace(loaded.dataset.source, part=file.path.name)
                    loaded = replace(loaded, dataset=replace(loaded.dataset, source=its))
                yield loaded

    @property
    def _every(self) -> int:
        assert self.project.data is not None
        return checked_every(self.project.data.options["every"])

    @cached_property
    def _excluded(self) -> frozenset[int]:
        """Row numbers over all files of the poses to leave out, each of which must be there."""
        assert self.project.data is not None
        asked = {pose_id(pose) for pose in self.project.data.options["exclude"]}
        if not asked:
            return frozenset()
        pose = self.project.data.options["pose"]
        found: dict[str, int] = {}
        begin = 0
        for file in self.files:
            for offset in range(0, file.rows, CHUNK):
                count = min(CHUNK, file.rows - offset)
                ids = [str(begin + i + 1) for i in range(count)]
                if pose is not None:
                    table = _rows(file, offset, CHUNK, {}, pose)
                    ids = list(table.ids(table.position(pose)))
                found |= {p: begin + i for i, p in enumerate(ids) if p in asked}
                begin += count
        for missing in sorted(asked - set(found)):
            raise InputError(
                f"there is no pose {missing!r} to leave out",
                place=self.name,
                remedy="ids are compared as they are written",
            )
        return frozenset(found.values())


def project_stream(project: Project) -> ParquetStream | None:
    """The readings of a project as a stream; None where they fit in memory.

    Raises InputError for files that are no Parquet, that do not have the same columns, and for
    several files joined by pose.
    """
    spec = project.data
    if spec is None or spec.stream is False:
        return None
    place = Place(project.name).at("data")
    path = expanded(spec.file, project.folder, place.at("file"))
    several = path.is_dir()
    if not several and (path.suffix.lower() not in ENDINGS or not path.is_file()):
        if spec.stream and path.is_file():
            raise InputError(
                f"{path.name} is no Parquet file, and others are not read in chunks",
                place=str(place.at("stream")),
                remedy="save it as Parquet, or leave stream out",
            )
        return None
    paths = sorted(p for p in path.iterdir() if p.suffix.lower() in ENDINGS) if several else [path]
    if not paths:
        raise InputError(
            f"the folder {path.name!r} holds no Parquet file",
            place=str(place.at("file")),
            remedy="put *.parquet files there, or name a file",
        )
    files = tuple(_File(p, *_shape(p)) for p in paths)
    if not several and spec.stream is None and files[0].rows < LARGE:
        return None
    if spec.joins:
        raise InputError(
            "readings in several files are joined in memory, and these come as a stream",
            place=str(place.at("join")),
            remedy="join the files beforehand, or say stream = false",
        )
    for file in files[1:]:
        if file.names != files[0].names:
            raise InputError(
                f"its columns are not those of {files[0].path.name}",
                place=file.path.name,
                remedy="give all files of the folder the same columns in the same order",
            )
    return ParquetStream(project, files, path.name)


def _shape(path: Path) -> tuple[int, tuple[str, ...]]:
    import polars as pl

    try:
        rows = pl.scan_parquet(path, glob=False).select(pl.len()).collect().item()
        return int(rows), tuple(pl.read_parquet_schema(path))
    except (pl.exceptions.PolarsError, OSError) as error:
        raise InputError(
            f"this is no Parquet file that can be read ({str(error).splitlines()[0]})",
            place=path.name,
            remedy="write it again",
        ) from None


def _rows(
    file: _File, offset: int, size: int, columns: dict[str, Column], pose: str | int | None
) -> Table:
    """Some rows of a file as a table, only the columns asked for."""
    import polars as pl

    asked = wanted(columns, pose)
    place = file.path.name
    positions = sorted({find_column(c, file.names, len(file.names), place) for c in asked})
    frame = (
        pl.scan_parquet(file.path, glob=False)
        .select([file.names[i] for i in positions])
        .slice(offset, size)
        .collect()
    )
    rows: NDArray[np.int64] = np.arange(offset + 1, offset + 1 + frame.height, dtype=np.int64)
    cells = dict(zip(positions, frame.get_columns(), strict=True))
    return Table(place, None, "", file.names, cells, rows)


def _span(number: NDArray[np.int64]) -> range:
    return range(int(number[0]), int(number[-1]) + 1)
