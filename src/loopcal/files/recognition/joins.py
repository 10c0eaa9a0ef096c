"""Several tables as one: side by side by pose ids, time or row order; or one below the other.

Times join where each is the only near one: of the rows that have a partner the nearest in time is
mutual, and nearer than a quarter of the time between two rows.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.recognition.fields import Field, Source, counted, told_apart
from loopcal.files.recognition.headers import heading, sd_of
from loopcal.files.recognition.joint_sets import names_joints
from loopcal.files.recognition.shots import pooled

Rows = NDArray[np.intp]
_SHARE_OF_STEP = 0.25
"""Rows of one time are nearer than this share of the time between rows."""
ROUNDED = 1e-6
"""Readings that two tables share differ by no more than this share of their span."""
_DIVIDED = re.compile(r"[\W_]|$")
"""What may follow the name of a pose in that of a shot: P07_t1 is of P07."""
_NUMBERED = re.compile(r"\D*0*(?P<number>\d+)\D*")
"""An id with one number in it: P07 and 7 are of one pose."""


@dataclass(frozen=True, eq=False)
class Fields:
    """All columns of all tables, a row per pose.

    by_order: whether rows of several tables were joined by their order; remarks: what was
    understood, for the reader.
    """

    sources: tuple[Source, ...]
    poses: tuple[str, ...]
    fields: tuple[Field, ...]
    by_order: bool = False
    remarks: tuple[str, ...] = field(default=())


def joined(sources: Sequence[Source]) -> Fields:
    """The tables side by side: by pose ids where all have them, or other names that they share, or
    the numbers in these, else by time where all state it, else by row order. Tables with the same
    columns stand one below the other.

    Raises InputError where none of this is possible, or where tables have rows of unlike poses.
    """
    _refuse_rows_of_joints(sources)
    sources = _named_after(_named_by_files(sources))
    first = sources[0]
    if len(sources) == 1:
        poses = first.ids or tuple(str(i) for i in range(1, len(first) + 1))
        return Fields(tuple(sources), poses, first.fields)
    if (stacked := _stacked(sources)) is not None:
        return stacked
    if all(s.ids is not None for s in sources):
        others = [set(s.ids or ()) for s in sources[1:]]
        common = [i for i in first.ids or () if all(i in ids for ids in others)]
        by_chance = 2 * len(common) <= min(map(len, sources)) and in_numbers(sources)
        if common and not by_chance:
            return _by_ids(sources, common)
    if alike := _by_other_names(sources):
        return alike
    if numbered := in_numbers(sources):
        return _by_ids(*numbered, by="the numbers in their ")
    timed = _by_time(sources)
    if timed is not None:
        return timed
    sources = _one_row_per_pose(sources)
    lengths = {s.name: len(s) for s in sources}
    if len({len(s) for s in sources}) > 1:
        counts = ", ".join(f"{name} has {length} rows" for name, length in lengths.items())
        raise InputError(
            f"the files cannot be joined: {counts}, and they share no column of pose ids",
            code="mismatched-poses",
            remedy='give each file a column "pose" with the same ids',
        )
    poses = tuple(str(i) for i in range(1, len(first) + 1))
    fields = _without_doubles([f for s in sources for f in s.fields])
    remark = f"{' and '.join(lengths)} share no pose ids: their rows are joined by order"
    return Fields(tuple(sources), poses, fields, True, (remark,))


def _refuse_rows_of_joints(sources: Sequence[Source]) -> None:
    """Raise InputError for a table with a row per joint beside one of poses."""
    for source in sources:
        ids = source.ids or ()
        others = [s for s in sources if s is not source]
        more = any(len(s) >= 2 * len(ids) and not {*ids} & {*(s.ids or ())} for s in others)
        if more and names_joints(ids, every=True):
            raise InputError(
                f"{source.name} has a row per joint, {ids[0]} to {ids[-1]}, and is no table of "
                "readings",
                code="mismatched-poses",
                remedy="leave it out: zeros belong into the column theta of the table for --dh, "
                "degrees per count into --joints, such as J1*0.0007+12.5",
            )


def _named_by_files(sources: Sequence[Source]) -> Sequence[Source]:
    """Tables of one column each, such as a file per joint: a column that several have is called as
    its file."""
    columns = [[f for f in s.fields if not f.is_time] for s in sources]
    shared = Counter(some[0].stem for some in columns if len(some) == 1)
    made = []
    for source, some in zip(sources, columns, strict=True):
        one = some[0] if len(some) == 1 else None
        if one is not None and shared[one.stem] > 1 and source.path is not None:
            unit = f" [{one.unit}]" if one.unit else ""
            named = replace(one, heading=heading(f"{source.path.stem}{unit}"))
            fields = tuple(named if f is one else f for f in source.fields)
            source = replace(source, fields=fields)
        made.append(source)
    return made


def _named_after(sources: Sequence[Source]) -> Sequence[Source]:
    """Tables whose rows are named after poses of the shortest, as P07_t1 and P07_t2 after P07, with
    the ids of these and the means of several shots."""
    poses = {*(min(sources, key=len).ids or ())}
    made = []
    for source in sources:
        ids, keys = source.ids or (), list[str]()
        for name in ids:
            parts = [name[: match.start()] for match in _DIVIDED.finditer(name)]
            keys.append(next((part for part in parts[::-1] if part in poses), name))
        means = pooled(source.fields, keys) if keys != [*ids] else None
        if means:
            remark = f"{source.name}: its rows are named after poses, as {ids[0]}. {means.remark}"
            remark = f"{source.remark} {remark}".strip()
            rows, names = means.fields, tuple(means.keys)
            source = Source(None, None, rows, names, "pose", (), source.name, remark)
        made.append(source)
    return made


def _by_other_names(sources: Sequence[Source]) -> Fields | None:
    """The rows of two tables that have the same names in columns that need not be those of ids;
    None where less than half of a table is in both."""
    if len(sources) != 2:
        return None
    named = [
        [*([("pose ids", s.ids)] if s.ids else []), *((repr(k), v) for k, v in s.texts.items())]
        for s in sources
    ]
    for first, names in named[0]:
        for other, others in named[1]:
            at = {name: i for i, name in enumerate(others)}
            rows = np.array([i for i, name in enumerate(names) if name in at], dtype=np.intp)
            if 2 * len(rows) <= min(map(len, sources)) or len({*others}) < len(others):
                continue
            there = np.array([at[names[i]] for i in rows], dtype=np.intp)
            by = first if first == other else f"{first} and {other}"
            remark = f"the files are joined by the names they share, {by}: {len(rows)} rows"
            one = replace(sources[0], ids=tuple(names))
            return paired((one, sources[1]), (rows, there), remark)
    return None


def in_numbers(sources: Sequence[Source]) -> tuple[list[Source], list[str]] | None:
    """The tables with the ids of the first where the numbers in them agree, and those in all; None
    where numbers repeat, or less than half of a table is in all.

    Where a table has no ids, an unnamed first column that counts takes their place. Tables may
    count in unlike steps: a robot's program has its poses p10, p20, ... of the points 1, 2, ...
    """
    every = list[tuple[Source, tuple[str, ...], tuple[int, ...]]]()
    for source in sources:
        ids, rest = source.ids, source.fields
        if ids is None:
            column = next((f for f in rest if f.position == 0 and f.heading is None), None)
            if column is None or not _counts(column.values):
                return None
            ids = tuple(f"{value:.0f}" for value in column.values)
            rest = tuple(f for f in rest if f is not column)
        matches = [_NUMBERED.fullmatch(name) for name in ids]
        numbers = tuple(int(match["number"]) for match in matches if match)
        if not len(ids) == len(numbers) == len({*numbers}):
            return None
        # A project joins files by equal ids alone: these readings go into a file of their own.
        every.append((replace(source, fields=rest, path=None, label=source.name), ids, numbers))
    steps = [max(math.gcd(*numbers), 1) for _, _, numbers in every]
    for divisors in ([1] * len(every), steps):
        numbered, names = [], dict[int, str]()
        for (source, ids, numbers), step in zip(every, divisors, strict=True):
            counts = [number // step for number in numbers]
            names = dict(zip(counts, ids, strict=True)) | names
            numbered.append(replace(source, ids=tuple(names[count] for count in counts)))
        others = [{*(s.ids or ())} for s in numbered[1:]]
        common = [name for name in numbered[0].ids or () if all(name in ids for ids in others)]
        if 2 * len(common) > min(map(len, sources)):
            return numbered, common
    return None


def _counts(values: Array) -> bool:
    return bool((values == np.round(values)).all() and (np.diff(values) > 0.0).all())


def _by_time(sources: Sequence[Source]) -> Fields | None:
    """The rows of two tables that were read at one time; None where times do not show this."""
    if len(sources) != 2:
        return None
    for first in (f for f in sources[0].fields if f.is_time):
        for other in (f for f in sources[1].fields if f.is_time):
            pairs = _nearest(first.values, other.values)
            if pairs is not None:
                late = other.values[pairs[1]] - first.values[pairs[0]]
                remark = (
                    f"the files are joined by time, {first.label!r} and {other.label!r}: "
                    f"{len(late)} rows, the second file late by {np.median(late):.3g} "
                    f"({late.min():.3g} to {late.max():.3g})"
                )
                return paired(sources, pairs, remark)
    return None


def _nearest(first: Array, other: Array) -> tuple[Rows, Rows] | None:
    """Rows of two columns of time that are near each other alone; None for fewer than half."""
    if not (np.isfinite(first).all() and np.isfinite(other).all()):
        return None
    apart = np.abs(first[:, None] - other[None])
    there, back = apart.argmin(axis=1), apart.argmin(axis=0)
    rows = np.flatnonzero(back[there] == np.arange(len(first)))
    steps = np.concatenate([np.diff(np.sort(first)), np.diff(np.sort(other))])
    if (steps <= 0.0).any():
        return None
    near = apart[rows, there[rows]] < _SHARE_OF_STEP * float(np.median(steps))
    rows = rows[near]
    if 2 * len(rows) <= min(len(first), len(other)):
        return None
    return rows, there[rows]


def paired(sources: Sequence[Source], pairs: tuple[Rows, Rows], remark: str) -> Fields:
    """Two tables side by side, in these rows of each; the times of the second are left out."""
    ids = sources[0].ids or tuple(str(i) for i in range(1, len(sources[0]) + 1))
    fields = [
        replace(f, values=f.values[rows])
        for source, rows in zip(sources, pairs, strict=True)
        for f in source.fields
    ]
    remarks = [remark]
    for source in sources:
        if len(source) > len(pairs[0]):
            remarks.append(f"{source.name}: {len(source) - len(pairs[0])} rows take no part")
    # Rows were chosen, so the files as they stand are no longer the readings.
    chosen = tuple(replace(s, path=None, label=s.name) for s in sources)
    poses = tuple(ids[i] for i in pairs[0])
    return Fields(chosen, poses, _without_doubles(fields), False, tuple(remarks))


def _one_row_per_pose(sources: Sequence[Source]) -> Sequence[Source]:
    """With the means of shots that follow each other, where a table has a multiple of the rows of
    the shortest and its rows agree in blocks."""
    least = min(map(len, sources))
    made = []
    for source in sources:
        shots, rest = divmod(len(source), least)
        blocks = np.repeat(np.arange(least), shots).tolist()
        means = pooled(source.fields, blocks) if shots > 1 and not rest else None
        if means:
            remark = f"{source.remark} {source.name}: {means.remark}".strip()
            made.append(Source(None, None, means.fields, None, None, (), source.name, remark))
            continue
        made.append(source)
    return made


def _by_ids(sources: Sequence[Source], common: Sequence[str], by: str = "") -> Fields:
    fields = []
    for source in sources:
        where = {pose: i for i, pose in enumerate(source.ids or ())}
        rows = np.array([where[pose] for pose in common], dtype=np.intp)
        fields += [replace(f, values=f.values[rows]) for f in source.fields]
    remarks = [f"the files are joined by {by}pose ids: {len(common)} poses are in all of them"]
    for source in sources:
        if len(source) > len(common):
            remarks.append(
                f"{source.name}: {len(source) - len(common)} poses are not in every file"
            )
    kept = _without_doubles(fields)
    return Fields(tuple(sources), tuple(common), kept, False, tuple(remarks))


def _stacked(sources: Sequence[Source]) -> Fields | None:
    """The poses of all tables, where they have the same columns; None where they have not."""
    first = sources[0]
    columns = [{(f.stem, f.unit) for f in s.fields} for s in sources]
    named = len(columns[0]) == len(first.fields) and all(f.stem for f in first.fields)
    if {stem for stem, _ in columns[0]} <= {*"xyz"}:
        return None  # points alone, or the slides of a machine beside its points
    if not named or any(quantities != columns[0] for quantities in columns):
        return None
    by_stem = [{f.stem: f for f in s.fields} for s in sources]
    fields = tuple(_below([of[f.stem] for of in by_stem]) for f in first.fields)
    ids = [i for s in sources for i in (s.ids or tuple(f"{s.name} {k + 1}" for k in range(len(s))))]
    if len(set(ids)) < len(ids):
        # Files may use the same ids for other poses.
        ids = [f"{s.name} {i}" for s in sources for i in s.ids or ()]
    names = " and ".join(s.name for s in sources)
    remark = f"{names} have the same columns: their {len(ids)} poses are taken together"
    one = Source(None, None, fields, tuple(ids), "pose")
    return Fields((one,), tuple(ids), fields, False, (remark,))


def _below(parts: Sequence[Field]) -> Field:
    """A column whose rows are those of several tables."""
    if any(part.labels for part in parts):
        return counted(parts[0], [part.words(v) for part in parts for v in part.values])
    return replace(parts[0], values=np.concatenate([part.values for part in parts]))


def _without_doubles(fields: Sequence[Field]) -> tuple[Field, ...]:
    """Without the columns that an earlier table has with the same values, and without later times.

    What two tables have with other values under one name is kept twice, and named by its file:
    points of a robot's controller beside those of a tracker. Their sds are named so too.
    """
    kept: list[Field] = []
    doubles = set[tuple[int, str]]()
    for field_ in fields:
        same = [k for k in kept if k.stem and k.stem == field_.stem and k.table != field_.table]
        if same and field_.is_time:
            continue
        if same and field_.heading:
            apart = np.abs(same[0].values - field_.values)
            if np.nanmax(apart, initial=0.0) <= ROUNDED * max(field_.span, 1e-12):
                continue
            doubles.add((field_.table, field_.stem))
        kept.append(field_)
    return tuple(
        _named_by_file(f, {stem for table, stem in doubles if table == f.table}) for f in kept
    )


def _named_by_file(field_: Field, doubles: Collection[str]) -> Field:
    """With its file in its name, where it is one of these columns or has their sds."""
    if not field_.heading or not (field_.stem in doubles or sd_of(field_.stem, doubles)):
        return field_
    number = field_.table + 1
    words = f"{field_.label} (file {number})"
    return replace(
        field_, heading=replace(field_.heading, text=words, stem=told_apart(field_.stem, number))
    )
