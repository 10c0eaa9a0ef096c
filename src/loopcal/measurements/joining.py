"""Readings from several files: of the same poses joined by their ids, of others one below another.

Encoders log in one file and instruments in others, each as long as it likes. A pose counts where
every file that reads the machine itself has it, and at least one of the others does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, refuse_repeated
from loopcal.measurements.dataset import Dataset


@dataclass(frozen=True, eq=False)
class Joined:
    """The poses that count, in the order of the files; left_out: ids that do not, by file name."""

    dataset: Dataset
    left_out: tuple[tuple[str, tuple[str, ...]], ...]


def join(parts: Sequence[Dataset], machine: Sequence[bool]) -> Joined:
    """One data set from several, NaN where a file does not have a pose.

    machine: for each part whether it reads the machine itself, without which a pose says nothing.
    Raises InputError for a pose that a file has twice, for a quantity that two files read, and
    where no pose is left.
    """
    _refuse_doubles(parts)
    everywhere = dict.fromkeys(pose for part in parts for pose in part.poses)
    have = [set(part.poses) for part in parts]
    needed = [h for h, of_machine in zip(have, machine, strict=True) if of_machine]
    others = [h for h, of_machine in zip(have, machine, strict=True) if not of_machine]
    kept = [
        pose
        for pose in everywhere
        if all(pose in h for h in needed) and (not others or any(pose in h for h in others))
    ]
    if not kept:
        raise InputError(
            "the files have no pose in common",
            code="mismatched-poses",
            place=" and ".join(_name(part, i) for i, part in enumerate(parts)),
            remedy="name the column of the pose ids of each file (pose = ...); ids must match "
            "exactly",
        )
    stays = set(kept)
    gone = [tuple(p for p in part.poses if p not in stays) for part in parts]
    dataset = _beside(parts, [_rows(part, kept) for part in parts], kept)
    names = [_name(part, i) for i, part in enumerate(parts)]
    return Joined(dataset, tuple((n, ids) for n, ids in zip(names, gone, strict=True) if ids))


def stacked(parts: Sequence[Dataset]) -> Dataset:
    """One data set of the poses of all, NaN for what a file does not read."""
    poses = [pose for part in parts for pose in part.poses]
    rows, begin = [], 0
    for part in parts:
        of_part = np.full(len(poses), -1, dtype=np.intp)
        of_part[begin : begin + len(part)] = np.arange(len(part))
        rows.append(of_part)
        begin += len(part)
    whole = _beside(parts, rows, poses)
    read = sum(part.source.rows_read for part in parts)
    entry = {"file": [part.source.entry for part in parts]}
    return replace(whole, source=replace(whole.source, rows_read=read, entry=entry))


def _beside(
    parts: Sequence[Dataset], rows: Sequence[NDArray[np.intp]], poses: Sequence[str]
) -> Dataset:
    """The parts as one, of which each has these poses at its rows, or -1."""
    first = parts[0]
    source = replace(
        first.source,
        rows=_file_rows(first, rows[0]),
        joined=tuple(
            replace(part.source, rows=_file_rows(part, r))
            for part, r in zip(parts[1:], rows[1:], strict=True)
        ),
        trusted=frozenset().union(*(part.source.trusted for part in parts)),
        stated={q: u for part in parts for q, u in part.source.stated.items()},
        entry={**first.source.entry, "join": [part.source.entry for part in parts[1:]]},
    )
    readings: dict[str, Array] = {}
    sds: dict[str, Array] = {}
    for part, r in zip(parts, rows, strict=True):
        for into, of in ((readings, part.readings), (sds, part.sds)):
            for q, values in of.items():
                into[q] = np.where(r >= 0, values[r], into.get(q, np.nan))
    units = {q: u for part in parts for q, u in part.units.items()}
    return Dataset(readings, units, tuple(poses), sds, source)


def _rows(part: Dataset, poses: Sequence[str]) -> NDArray[np.intp]:
    """Where a part has these poses, -1 where it does not."""
    place = {pose: i for i, pose in enumerate(part.poses)}
    return np.array([place.get(pose, -1) for pose in poses], dtype=np.intp)


def _file_rows(part: Dataset, rows: NDArray[np.intp]) -> NDArray[np.int64] | None:
    if part.source.rows is None:
        return None
    # Rows of a file count from 1, so 0 says that the file has no such pose.
    return np.where(rows >= 0, part.source.rows[rows], 0)


def _name(part: Dataset, number: int) -> str:
    return part.source.name or f"part {number + 1}"


def _refuse_doubles(parts: Sequence[Dataset]) -> None:
    read: dict[str, str] = {}
    for number, part in enumerate(parts):
        name = _name(part, number)
        for quantity in part.readings:
            if quantity in read:
                raise InputError(
                    f"{quantity!r} is read from {read[quantity]} and from {name}",
                    code="duplicate-column",
                    place=name,
                    remedy="name its column for one of the two files",
                )
            read[quantity] = name
        refuse_repeated(
            part.poses,
            "the pose {!r} occurs twice, but readings are joined by pose",
            "give every pose a unique id, or average the repeated readings",
            part.place,
        )
