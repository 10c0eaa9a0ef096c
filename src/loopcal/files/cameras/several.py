"""Corners that stand in several files: one for each camera, for each image, or parts of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.corners import split_name
from loopcal.mechanisms.cameras.lens import Intrinsics

UNNAMED = "1"
"""The image or camera of a table that names none."""
_ALIKE = 2.0
"""Two files hold the same corners where half of them agree within this [px]: two detectors of one
image do, two cameras do not."""


def together(tables: Sequence[tuple[Path, CornerTable]]) -> CornerTable:
    """One table of all: a file without a column of images is one image, and of files that show the
    same images each is a camera, named by what differs in the names of the files.

    Raises InputError where two files hold the same corners.
    """
    if len(tables) == 1:
        return tables[0][1]
    paths = [path for path, _ in tables]
    some = [table for _, table in tables]
    if all(table.images == (UNNAMED,) for table in some):
        views = [split_name(name) for name in differing(paths)]
        some = [_named(table, *view) for table, view in zip(some, views, strict=True)]
    _refuse_copies(paths, some)
    unnamed = all(table.cameras == (UNNAMED,) for table in some)
    stated = [split_name(f"0-{name}")[1] for name in differing(paths)]
    if unnamed and (all(stated) or _common(some)):
        names = stated if all(stated) else differing(paths)
        some = [_named(table, "", camera) for table, camera in zip(some, names, strict=True)]
    if _common(some):
        raise InputError(
            f"{len(some)} files hold corners of the same images: "
            f"{listed([path.name for path in paths], 5)}",
            code="conflicting-keys",
            remedy="name one of them, or add a column of the camera to each",
        )
    return _joined(some)


def differing(paths: Sequence[Path]) -> list[str]:
    """What differs in the names of files, by whole words: cam0/corners.csv and cam1/corners.csv are
    cam0 and cam1.

    >>> differing([Path("corners_left.csv"), Path("corners_right.csv")])
    ['left', 'right']
    """
    whole = [str(path.with_suffix("")) for path in paths]
    front = _shared(whole)
    back = _shared([name[len(front) :][::-1] for name in whole])[::-1]
    marks = "/\\_-. "
    while front and front[-1] not in marks:
        front = front[:-1]
    while back and back[0] not in marks:
        back = back[1:]
    names = [name[len(front) : len(name) - len(back)].strip(marks) for name in whole]
    return names if all(names) and len({*names}) == len(names) else whole


def _shared(names: Sequence[str]) -> str:
    """The characters that all begin with, which the first and the last in order show."""
    first, last = min(names), max(names)
    return "".join(a for i, a in enumerate(first) if first[: i + 1] == last[: i + 1])


def each_named(lenses: Mapping[Path, Mapping[str, Intrinsics]]) -> dict[str, Intrinsics]:
    """The lenses of all files by name; of files that name them alike by what differs in the names
    of the files."""
    names = [name for some in lenses.values() for name in some]
    if len({*names}) == len(names):
        return {name: lens for some in lenses.values() for name, lens in some.items()}
    return {
        file if len(some) == 1 else f"{file}_{name}": lens
        for file, some in zip(differing([*lenses]), lenses.values(), strict=True)
        for name, lens in some.items()
    }


def _named(table: CornerTable, image: str, camera: str) -> CornerTable:
    return replace(
        table,
        image=(image,) * len(table) if image else table.image,
        camera=(camera,) * len(table) if camera else table.camera,
        sizes=tuple((camera or name, size) for name, size in table.sizes),
    )


def _keys(table: CornerTable) -> list[tuple[str, ...]]:
    return list(zip(table.image, table.camera, table.board, table.point, strict=True))


def _common(tables: Sequence[CornerTable]) -> bool:
    """Whether a corner of an image stands in two of them."""
    keys = [{*_keys(table)} for table in tables]
    return len(set().union(*keys)) < sum(map(len, keys))


def _refuse_copies(paths: Sequence[Path], tables: Sequence[CornerTable]) -> None:
    met: dict[tuple[str, ...], tuple[Path, float, float]] = {}
    for path, table in zip(paths, tables, strict=True):
        away = []
        for key, u, v in zip(_keys(table), table.u.tolist(), table.v.tolist(), strict=True):
            first = met.setdefault(key, (path, u, v))
            if first[0] != path:
                away.append((float(np.hypot(u - first[1], v - first[2])), first[0]))
        if away and float(np.median([distance for distance, _ in away])) < _ALIKE:
            raise InputError(
                f"{away[0][1].name} and {path.name} hold the same corners",
                code="conflicting-keys",
                remedy="name one of them",
            )


def _joined(tables: Sequence[CornerTable]) -> CornerTable:
    def names(columns: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
        return tuple(name for column in columns for name in column)

    def values(columns: Sequence[Array | None]) -> Array | None:
        if all(column is None for column in columns):
            return None
        filled = [
            np.full(len(table), np.nan) if column is None else column
            for table, column in zip(tables, columns, strict=True)
        ]
        return np.concatenate(filled)

    return CornerTable(
        names([t.image for t in tables]),
        names([t.camera for t in tables]),
        names([t.board for t in tables]),
        names([t.point for t in tables]),
        np.concatenate([t.u for t in tables]),
        np.concatenate([t.v for t in tables]),
        values([t.sd for t in tables]),
        values([t.level for t in tables]),
        listed([t.file for t in tables], 3),
        tuple(dict(pair for t in tables for pair in t.sizes).items()),
    )
