"""Reads each of several files of readings, and puts files with different poses together."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.project.data_table import DataTable, FileTable, JoinTable, implied_by
from loopcal.files.tables.readers import (
    Column,
    column_labels,
    read_dataset,
    read_once,
    read_poses,
    read_table,
)
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def read_part(
    data: DataTable,
    part: FileTable,
    path: Path,
    mechanism: Mechanism,
    aside: Mapping[str, Column],
) -> Dataset:
    """One of several files, with columns read aside where it has them.

    Raises InputError for a file that holds nothing of the machine.
    """
    source = read_once(path, **part.keywords)
    labels = column_labels(source)
    part = data.columns_of(part, labels, mechanism)
    if part.pose is None and not data.apart:
        raise InputError(
            "joining several files needs pose ids",
            code="mismatched-poses",
            place=str(path),
            remedy='name the column of the ids: pose = "..."; or state pose = 0 for each file, '
            "to join them row by row",
        )
    columns = {**part.columns, **{k: c for k, c in aside.items() if c.column in labels}}
    used = part.instrument if isinstance(part, JoinTable) else ()
    implied = [q for name in used for q in implied_by(mechanism, name)]
    if not columns and not implied:
        raise InputError(
            "no column of this file is a quantity of the mechanism",
            code="missing-column",
            place=str(path),
            remedy="name its columns: columns = { x = ... }",
        )
    if columns:
        read = believed(part, read_dataset(source, columns, pose=part.pose, **part.keywords))
    else:  # ids alone: the poses in which an instrument without readings was used
        read = read_poses(source, part.pose or 0, **part.keywords)
    read = read.with_readings({q: np.full(len(read), mechanism.implied[q]) for q in implied})
    if isinstance(part, JoinTable) and part.where:
        read = read.take(_chosen(path, part))
    return read


def believed(spec: FileTable, read: Dataset) -> Dataset:
    """The readings with sds no smaller than the project believes."""
    least = {q: column.sd_at_least or 0.0 for q, column in spec.columns.items()}
    # fmax: a missing sd becomes the smallest one that is believed.
    sds = {q: np.fmax(v, least.get(q, 0.0)) for q, v in read.sds.items()}
    return replace(read, sds=sds)


def _chosen(path: Path, part: JoinTable) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """The rows that count."""
    table = read_table(path, **part.keywords)
    chosen = np.ones(len(table.ids(0)), dtype=bool)
    for column, value in part.where.items():
        cells = table.ids(table.position(column))
        chosen &= np.array([fnmatchcase(cell, value) for cell in cells])
    if not chosen.any():
        raise InputError(
            f"no row has {listed([f'{c} = {v!r}' for c, v in part.where.items()])}",
            code="no-data",
            place=str(path),
            remedy="name values that the columns have; * stands for any letters",
        )
    return chosen


def one_below_another(
    data: DataTable,
    files: Sequence[tuple[Path, FileTable]],
    mechanism: Mechanism,
    aside: Mapping[str, Column],
) -> Dataset:
    """Files with poses of their own; what one does not hold was not read in its poses.

    Raises InputError for a file without a joint between two bodies that an instrument sees in it.
    """
    from loopcal.files.recognition.rows import reach
    from loopcal.measurements.joining import stacked

    parts = []
    for path, table in files:
        part = read_part(data, table, path, mechanism, aside)
        for family in mechanism.families if mechanism.tree is not None else ():
            absent = sorted(reach(mechanism, family) - part.readings.keys())
            if absent and part.readings.keys() & {*family.readings}:
                raise InputError(
                    f"no column holds the joint {absent[0]!r} between {family.on!r} and "
                    f"{family.against!r}, which {family.name!r} sees",
                    code="missing-column",
                    place=str(path),
                    remedy=f'name it: columns = {{ {absent[0]} = "its column" }}',
                )
        ids = tuple(f"{path.stem}:{pose}" for pose in part.poses)
        parts.append(replace(part, poses=ids))
    return stacked(parts)


def of_another_day(
    data: DataTable, paths: Sequence[Path], mechanism: Mechanism, needless: Collection[str]
) -> Dataset:
    """Files in the columns of those of the project, which have poses of their own.

    needless: quantities that need not be read. What no file holds was not read.
    """
    wanted = tuple(
        replace(part, columns={q: c for q, c in part.columns.items() if q not in needless})
        for part in data.parts
    )
    files = [(path, part) for path in paths for part in _like(data, wanted, path, mechanism)]
    read = one_below_another(data, files, mechanism, {})
    seen = [q for family in mechanism.families for q in family.readings]
    blank = np.full(len(read), np.nan)
    gone = [q for q in (*mechanism.joints, *seen) if q not in read.readings]
    return read.with_readings(dict.fromkeys(gone, blank))


def _like(
    data: DataTable,
    parts: Sequence[FileTable],
    path: Path,
    mechanism: Mechanism,
) -> list[FileTable]:
    """The tables of that file of the project whose columns this one has, most of all.

    Where several have as many, the one whose name this file's holds. Raises InputError otherwise.
    """
    counts: dict[str, int] = {}
    for part in parts:
        labels = column_labels(read_once(path, **part.keywords))
        named = [c.column for c in data.columns_of(part, labels, mechanism).columns.values()]
        if named and all(isinstance(column, int) or column in labels for column in named):
            counts[part.file] = max(counts.get(part.file, 0), len(named))
    best = [file for file, count in counts.items() if count == max(counts.values())]
    if len(best) > 1:
        best = [file for file in best if Path(file).stem in path.stem] or best
    if len(best) != 1:
        names = listed([Path(part.file).name for part in parts], 10)
        raise InputError(
            "the columns are those of several files of the project"
            if best
            else "the columns are those of no file of the project",
            code="missing-column",
            place=str(path),
            remedy=f"name the file so that it holds the name of the one it is like: {names}",
        )
    return [part for part in parts if part.file == best[0]]
