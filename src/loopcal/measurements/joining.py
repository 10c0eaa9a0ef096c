"""Readings of the same poses from several files, joined by pose id.

Encoders log in one file and instruments in others, each as long as it likes. A pose counts where
every file that reads the machine itself has it, and at least one of the others does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
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
    rows = [_rows(part, kept) for part in parts]
    stays = set(kept)
    gone = [tuple(p for p in part.poses if p not in stays) for part in parts]
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
    dataset = Dataset(
        {
            q: _spread(values, r)
            for part, r in zip(parts, rows, strict=True)
            for q, values in part.readings.items()
        },
        {q: u for part in parts for q, u in part.units.items()},
        tuple(kept),
        {
            q: _spread(values, r)
            for part, r in zip(parts, rows, strict=True)
            for q, values in part.sds.items()
        },
        source,
    )
    names = [_name(part, i) for i, part in enumerate(parts)]
    return Joined(dataset, tuple((n, ids) for n, ids in zip(names, gone, strict=True) if ids))


def _rows(part: Dataset, poses: Sequence[str]) -> NDArray[np.intp]:
    """Where a part has these poses, -1 where it does not."""
    place = {pose: i for i, pose in enumerate(part.poses)}
    return np.array([place.get(pose, -1) for pose in poses], dtype=np.intp)


def _spread(values: Array, rows: NDArray[np.intp]) -> Array:
    return np.where(rows >= 0, values[rows], np.nan)


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
        seen: set[str] = set()
        for i, pose in enumerate(part.poses):
            if pose in seen:
                raise InputError(
                    f"the pose {pose!r} occurs twice, but readings are joined by pose",
                    code="duplicate-name",
                    place=part.place(i),
                    remedy="give every pose a unique id, or average the repeated readings",
                )
            seen.add(pose)
