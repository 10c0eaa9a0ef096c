"""Readings of a Parquet file, or of a folder of them, that are read chunk by chunk.

A chunk is read where it is worked on, be it another process or another machine: a stream that is
sent there is paths and row numbers, with a mark by which each file is known again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.outputs import expanded
from loopcal.files.project.parts import believed
from loopcal.files.project.project_data import (
    LoadedData,
    columns_aside,
    load_dataset,
    loaded_from,
)
from loopcal.files.project.project_file import Project
from loopcal.files.tables.parquet import (
    READER,
    ParquetFile,
    begins_of,
    frame_of,
    parquet_files,
    prove,
    sha256_of_all,
)
from loopcal.files.tables.raw import sha256_of
from loopcal.files.tables.readers import Column, dataset_of, refuse_doubles, specified, wanted
from loopcal.files.tables.registry import reader_of
from loopcal.files.tables.table import ROW, Table, positions_of
from loopcal.files.toml.place import Place
from loopcal.lazy import cached_property
from loopcal.measurements.checks import DataWarning, check_dataset
from loopcal.measurements.dataset import checked_every
from loopcal.measurements.poses import pose_id
from loopcal.measurements.source import Source
from loopcal.mechanisms.outputs import measured_points

if TYPE_CHECKING:
    from loopcal.estimation.stream.merit import Chunk

LARGE = 2_000_000
"""Rows from which on a file is read in chunks unless the project says otherwise."""
# The last bits of all sums depend on it: a resumed run needs the same (docs/decisions/0016).
CHUNK = 65_536


@dataclass(frozen=True)
class _Part:
    """Some rows of a file; begin: of them the first among those of all files."""

    file: ParquetFile
    offset: int
    rows: int
    begin: int


@dataclass(frozen=True, eq=False)
class ParquetStream:
    """The poses of a project, in chunks of at most so many rows of one file.

    What is found out about the files as a whole is found once, and travels with it.
    """

    project: Project
    files: tuple[ParquetFile, ...]
    name: str

    @cached_property
    def sha256(self) -> str:
        """Of the file, or of the list of all files' own."""
        return sha256_of_all(self._sha256s)

    @cached_property
    def _sha256s(self) -> tuple[str, ...]:
        """SHA-256 of each file."""
        return tuple(sha256_of(file.path) for file in self.files)

    @cached_property
    def poses(self) -> int:
        """How many there are after thinning and exclusion."""
        every, gone = self._every, self._excluded
        # The negated floor is the ceiling: row 0 is kept, and each `every`-th after it.
        thinned = -(-sum(file.rows for file in self.files) // every)
        return thinned - sum(row % every == 0 for row in gone)

    @cached_property
    def warnings(self) -> tuple[DataWarning, ...]:
        """What looks odd about the first chunk, and files that are there twice.

        Raises InputError as `check_dataset` does.
        """
        loaded = self._loaded(self._parts[0])
        mechanism = self.project.mechanism
        units = mechanism.units
        odd = check_dataset(loaded.dataset, units, points=measured_points(mechanism))
        return (*odd, *self._repeated_files(), *self._folders_inside())

    def _repeated_files(self) -> Iterator[DataWarning]:
        seen: dict[str, str] = {}
        for file, file_sha256 in zip(self.files, self._sha256s, strict=True):
            name = file.path.name
            first = seen.setdefault(file_sha256, name)
            if first != name:
                yield DataWarning(
                    None,
                    f"{self.name}: {name} has the same content as {first}, so its poses count "
                    f"twice; remove one of them",
                )

    def _folders_inside(self) -> Iterator[DataWarning]:
        if self.files[0].path.name == self.name:  # a file was asked for, not its folder
            return
        folder = self.files[0].path.parent
        inside = sorted(p for e in READER.endings for p in folder.glob(f"*/*{e}"))
        if inside:
            yield DataWarning(
                None,
                f"{self.name}: its subfolders are not read, but contain Parquet files such as "
                f"{inside[0].relative_to(folder).as_posix()}; move them up if they belong to it",
            )

    @property
    def count(self) -> int:
        """How many chunks there are."""
        return len(self._parts)

    def chunk(self, number: int) -> Chunk:
        """The chunk of this number, from 0.

        Raises InputError where its file is not there, or not the one of the beginning.
        """
        loaded = self._loaded(self._parts[number])
        from loopcal.estimation.stream.merit import Chunk

        return Chunk(loaded.dataset, loaded.noise)

    @cached_property
    def _parts(self) -> tuple[_Part, ...]:
        """All parts with a pose that is used."""
        return tuple(part for part in _parts(self.files) if self._used(part).any())

    def _used(self, part: _Part) -> NDArray[np.bool_]:
        """Which rows of a part are used."""
        used: NDArray[np.bool_] = np.arange(part.begin, part.begin + part.rows) % self._every == 0
        used[[row - part.begin for row in self._excluded if 0 <= row - part.begin < part.rows]] = (
            False
        )
        return used

    def _loaded(self, part: _Part) -> LoadedData:
        spec = self.project.data
        assert spec is not None
        columns = specified({**spec.columns, **columns_aside(self.project)}, {})
        pose = spec.pose
        table = _rows(part, columns, pose)
        refuse_doubles(table, columns)
        source = Source(
            self.name,
            part.file.path.name if len(self.files) > 1 else None,
            sha256=self.sha256,
            rows_read=sum(f.rows for f in self.files),
            excluded=tuple(map(pose_id, spec.exclude)),
            every=self._every,
        )
        ids = _ids(part, table, pose)
        read = dataset_of(table, columns, np.flatnonzero(self._used(part)), ids, source)
        return loaded_from(self.project, believed(spec, read))

    @property
    def _every(self) -> int:
        assert self.project.data is not None
        return checked_every(self.project.data.every)

    @cached_property
    def _excluded(self) -> frozenset[int]:
        """Row numbers over all files of the poses to leave out, each of which must be there."""
        assert self.project.data is not None
        asked = {pose_id(pose) for pose in self.project.data.exclude}
        if not asked:
            return frozenset()
        pose = self.project.data.pose
        row_numbers: dict[str, int] = {}
        for part in _parts(self.files):
            ids = _ids(part, None if pose in (None, ROW) else _rows(part, {}, pose), pose)
            row_numbers |= {p: part.begin + i for i, p in enumerate(ids) if p in asked}
        for missing in sorted(asked - set(row_numbers)):
            raise InputError(
                f"there is no pose {missing!r} to exclude",
                code="unknown-name",
                place=self.name,
                remedy="ids must match exactly",
            )
        return frozenset(row_numbers.values())


def project_stream(project: Project) -> ParquetStream | None:
    """The readings of a project as a stream; None where they fit in memory.

    Raises InputError for files that are no Parquet, that do not have the same columns, and for
    several files joined by pose.
    """
    spec = project.data
    if spec is None or spec.stream is False:
        return None
    place = Place(project.name).at("data")
    path = expanded(spec.parts[0].file, project.folder, place.at("file"))
    several = path.is_dir()
    if reader_of(path) is not READER or not path.exists():
        if spec.stream and path.exists():
            raise InputError(
                f"{path.name} is not a Parquet file; only Parquet is read in chunks",
                code="wrong-file-type",
                place=str(place.at("stream")),
                remedy="save it as Parquet, or remove stream",
            )
        return None
    files = parquet_files(path)
    if not several and spec.stream is None and files[0].rows < LARGE:
        return None
    if len(spec.parts) > 1:
        raise InputError(
            "several files can only be read in memory, but these are read as a stream",
            code="unsupported",
            place=str(place.at("join")),
            remedy="join the files beforehand, or set stream = false",
        )
    columns = specified({**spec.columns, **columns_aside(project)}, {})
    asked = wanted(columns, spec.pose)
    names = files[0].names
    prove(files, [names[i] for i in positions_of(asked, names, files[0].path.name)])
    return ParquetStream(project, files, path.name)


def load_sample(project: Project) -> LoadedData:
    """The readings of a project; of a stream about ten thousand poses, evenly thinned.

    The first warning then says so. Raises InputError as `load_dataset` and `project_stream` do.
    """
    from loopcal.estimation.stream.calibrate import SHOWN

    stream = project_stream(project)
    if stream is None or stream.poses < 2 * SHOWN:
        return load_dataset(project)
    assert project.data is not None
    step = stream.poses // SHOWN
    every = project.data.every * step
    loaded = load_dataset(replace(project, data=replace(project.data, every=every)))
    # Sds fall with the root of the number of poses.
    thinning_warning = DataWarning(
        None,
        f"{stream.name}: only {len(loaded.dataset)} of {stream.poses} poses are checked (every "
        f"= {every}); with all poses the sds are up to {math.sqrt(step):.2g} times smaller",
    )
    return replace(loaded, warnings=(thinning_warning, *loaded.warnings))


def _parts(files: tuple[ParquetFile, ...]) -> list[_Part]:
    begins = begins_of(files)
    return [
        _Part(file, offset, min(CHUNK, file.rows - offset), begins[file.path.name] + offset)
        for file in files
        for offset in range(0, file.rows, CHUNK)
    ]


def _ids(part: _Part, table: Table | None, pose: str | int | None) -> Sequence[str]:
    """The ids of a part's rows: those in a column, else their numbers among all rows."""
    if table is None or pose in (None, ROW):
        return [*map(str, range(part.begin + 1, part.begin + 1 + part.rows))]
    return table.ids(table.position(pose))


def _rows(part: _Part, columns: dict[str, Column], pose: str | int | None) -> Table:
    """The rows of a part as a table, only the columns asked for."""
    file = part.file
    positions = positions_of(wanted(columns, pose), file.names, file.path.name)
    frame = frame_of(file, [file.names[i] for i in positions], part.offset, part.rows)
    rows: NDArray[np.int64] = part.offset + 1 + np.arange(part.rows, dtype=np.int64)
    cells = dict(zip(positions, frame.get_columns(), strict=True))
    return Table(file.path.name, None, "", file.names, cells, rows, before=part.begin)
