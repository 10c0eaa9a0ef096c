"""Tables by time: a log of a robot that goes from pose to pose is read where it stands."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.files.recognition.fields import Field, Source
from loopcal.files.recognition.headers import stem
from loopcal.files.recognition.joint_sets import usual_joints
from loopcal.files.tables.recording import STILL, Recording, Series

_OFTEN = STILL / 3.0
"""[s] between rows of a log at most: some of them lie in each window. Poses come more slowly."""
_FEW = 50
# Seconds since 1970 are 10 digits, the others 3 more each.
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_EPOCHS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


@dataclass(frozen=True, eq=False)
class Columns:
    """Where the columns of tables are recorded by time: (table, position) -> its series, and which
    of its columns; the recordings."""

    at: Mapping[tuple[int, int], tuple[Series, int]]
    recordings: tuple[Recording, ...]


def at_rest(sources: Sequence[Source], names: Collection[str] = ()) -> tuple[list[Source], Columns]:
    """The tables, those by time as one row for each stand, and where their columns come from.

    Several logs share one clock. names: of the machine's joints; else their columns are known by
    usual names. Raises InputError for a log without a stand.
    """
    recorded = _recorded(sources)
    tables = [one for one in sources if one.recording is None]
    # Beside the stamp of a reading a log may have the time of its receipt.
    stamped = all(any(_is_stamp(f) for f in one.fields) for one in tables)
    # The last joint of S, L, U, R, B, T is no time.
    joints = {id(f) for one in sources for f in _joints(one.fields, names)}
    logs = {
        i: times
        for i, one in enumerate(sources)
        if one.recording is None and (times := _times(one, stamped, joints)) is not None
    }
    fields = [f for i in logs for f in sources[i].fields if id(f) in joints or not f.is_time]
    joints = {id(f) for f in _joints(fields, names)}
    if not joints:
        return list(sources), recorded
    at: dict[tuple[int, int], tuple[Series, int]] = {}
    by_joint, measured = {}, {}
    begin = min(float(np.nanmin(times)) for times in logs.values())
    for i, times in logs.items():
        rows = np.isfinite(times)
        since = times[rows] - begin + _OFTEN  # zero counts as a missing stamp
        rest = [f for f in sources[i].fields if not f.is_time and id(f) not in joints]
        for f in sources[i].fields:
            if id(f) in joints:
                by_joint[f.label] = Series(since, f.values[rows][:, None], (f.label,))
                at[f.table, f.position] = by_joint[f.label], 0
        if rest:
            values = np.column_stack([f.values[rows] for f in rest])
            one = Series(since, values, tuple(f"{f.table} {f.position}" for f in rest))
            measured[sources[i].name] = one
            at |= {(f.table, f.position): (one, k) for k, f in enumerate(rest)}
    recording = Recording(by_joint, measured)
    names = " and ".join(sources[i].name for i in logs)
    recording.refuse_unusable(names)
    numbers = [recording.table[s.names[k]] for s, k in at.values()]
    by_place = {(f.table, f.position): f for f in fields}
    poses = tuple(
        replace(by_place[place], values=values)
        for place, values in zip(at, numbers, strict=True)
        if np.isfinite(values).any()
    )
    remark = f"{names}: a log. {' '.join(recording.words())}"
    first = next(iter(logs))
    if len(logs) == 1:
        middle = recording.stands.mean(axis=1) + begin - _OFTEN
        poses = (_when(sources[first], stamped, joints, middle), *poses)
    made = Source(None, None, poses, None, None, label=names, remark=remark)
    kept = [
        made if i == first else one for i, one in enumerate(sources) if i not in logs or i == first
    ]
    return kept, Columns({**recorded.at, **at}, (*recorded.recordings, recording))


def _recorded(sources: Sequence[Source]) -> Columns:
    """Where the columns of bags come from."""
    at: dict[tuple[int, int], tuple[Series, int]] = {}
    recordings = [(one, one.recording) for one in sources if one.recording is not None]
    for source, recording in recordings:
        series = (*recording.joints.values(), *recording.measured.values())
        by_name = {name: (one, k) for one in series for k, name in enumerate(one.names)}
        at |= {
            (source.fields[0].table, i): by_name[name]
            for i, name in enumerate(recording.columns)
            if name in by_name
        }
    return Columns(at, tuple(recording for _, recording in recordings))


def _named(fields: Sequence[Field], names: Collection[str]) -> list[Field]:
    """Columns of the joints' names; of those with one end, as "elbow.position", the most."""
    by_end: dict[str, list[Field]] = {}
    for name in map(stem, names):
        for f in fields:
            if f.stem == name or f.stem.startswith(f"{name}_"):
                by_end.setdefault(f.stem.removeprefix(name), []).append(f)
    return max(by_end.values(), key=len, default=[])


def _joints(fields: Sequence[Field], names: Collection[str]) -> Sequence[Field]:
    return _named(fields, names) or usual_joints(fields)


def _is_stamp(field: Field) -> bool:
    return field.stem.rpartition("_")[2] == "stamp"


def _times(source: Source, stamped: bool, joints: Set[int]) -> Array | None:
    """(N,) times [s] of a log, its stamps where it has some; None of a table of poses."""
    column = _clock(source, stamped, joints)
    if column is None or len(source) < _FEW:
        return None
    times = _factor(column) * column.values
    steps = np.abs(np.diff(times[np.isfinite(times)]))
    return times if steps.size and 0.0 < np.median(steps) <= _OFTEN else None


def _clock(source: Source, stamped: bool, joints: Set[int]) -> Field | None:
    """The column of times that counts."""
    free = (f for f in source.fields if id(f) not in joints)
    return next((f for f in free if (_is_stamp(f) if stamped else f.is_time)), None)


def _when(source: Source, stamped: bool, joints: Set[int], times: Array) -> Field:
    """The column of times of a log, a row for each of its stands: an instrument that was read once
    at each joins by it. times: (N,) [s]."""
    column = _clock(source, stamped, joints)
    assert column is not None
    return replace(column, values=times / _factor(column))


def _factor(column: Field) -> float:
    """Seconds of one unit of a column of stamps."""
    if column.unit in _SECONDS:
        return _SECONDS[column.unit]
    largest = np.nanmax(column.values, initial=0.0)
    return next((factor for least, factor in _EPOCHS if largest > least), 1.0)
