"""Columns of an instrument as quantities of a project; and the table that says so for other days.

What `init` has understood of the first files is stated as `SourceTable`; `converted` reads later
files of that layout by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.files.cameras.folder import tables_of
from loopcal.files.project.data_table import SourceInstrument, SourceTable
from loopcal.files.recognition.fields import STATIONS, Field, unnamed
from loopcal.files.recognition.joins import Fields, joined
from loopcal.files.recognition.joint_sets import computed_column
from loopcal.files.recognition.layouts import Seen, at_station
from loopcal.files.recognition.logs import at_rest
from loopcal.files.recognition.meanings import Meaning, inverse, polar, positions, turned_by
from loopcal.files.recognition.sources import sources_of_all
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import rounding_sd
from loopcal.units import to_si, unit

Rows = NDArray[np.bool_]
_OF = " of "
"""Between the header of a column and the label of its station or target, in rows of their own."""


@dataclass(frozen=True, eq=False)
class Reading:
    """A quantity of the project: its column, or converted values.

    values: (N,) [SI]; si: their SI unit; field: its column, None where it was converted; unit: of
    that column; sds: the column of its sds.
    """

    values: Array
    si: str
    field: Field | None
    unit: str
    sds: Field | None = None


def as_vector(meaning: Meaning) -> bool:
    """Whether the columns of a pose are a rotation vector as they stand."""
    return meaning.form == "rotation-vector" and not meaning.inverted


def readings_of(m: Meaning, names: Sequence[str]) -> dict[str, Reading]:
    """Quantity -> its column, or converted values; names: of the position, then of the turn."""
    made = {}
    position = m.position[:, None] if m.position.ndim == 1 else m.position
    count = len(m.seen.position)
    for i, name in enumerate(names[:count]):
        field = m.seen.position[i]
        si = "rad" if m.seen.kind == "spherical" and i else "m"
        unit_name = field.unit or (m.angle if si == "rad" else m.length)
        if m.seen.kind == "spherical":
            values, as_written = polar(m)[i], not m.form
        else:
            values, as_written = position[:, i], not m.inverted
        sds = m.seen.sds[i] if m.seen.sds and not m.inverted else None
        made[name] = Reading(values, si, field if as_written else None, unit_name, sds)
    if m.turns is None:
        return made
    if as_vector(m):
        for name, column in zip(names[count:], m.order, strict=True):
            field = m.seen.turned[column]
            made[name] = Reading(unit(m.angle).factor * field.values, "rad", field, m.angle)
        return made
    as_written = m.form == "quaternion" and not m.inverted
    for i, (name, values) in enumerate(zip(names[count:], quaternions(m.turns), strict=True)):
        turn_field = m.seen.turned[m.order[i]] if as_written else None
        made[name] = Reading(turn_field.values if turn_field else values, "1", turn_field, "1")
    return made


def quaternions(R: Array) -> Array:
    """(4, N) w first, of rotations (N, 3, 3); NaN where the rotation is unknown."""
    from scipy.spatial.transform import Rotation

    finite = np.isfinite(R).all(axis=(1, 2))
    out = np.full((4, len(R)), np.nan)
    # SciPy has w last.
    out[:, finite] = Rotation.from_matrix(R[finite]).as_quat()[:, [3, 0, 1, 2]].T
    return out


def dataset_of(poses: Sequence[str], readings: Mapping[str, Reading]) -> Dataset:
    """The readings as values."""

    def sds(reading: Reading) -> Array:
        assert reading.sds is not None
        factor = unit(reading.sds.unit or reading.unit).factor
        # An sd that was rounded to 0 would make the reading exact.
        step = rounding_sd(reading.sds.resolution())
        return factor * np.fmax(reading.sds.values, step)

    return Dataset.from_arrays(
        {name: r.values for name, r in readings.items()},
        units={name: r.si for name, r in readings.items()},
        poses=poses,
        sds={name: sds(r) for name, r in readings.items() if r.sds is not None},
    )


# The table


def source_entry(
    fields: Fields,
    columns: Mapping[str, Reading],
    seen: Sequence[tuple[Meaning, Sequence[str]]],
    sheet: str | None,
) -> dict[str, Any]:
    """What was understood, as [data.source] states it; seen: instruments, each with its
    quantities."""

    def keys(some: Sequence[Field]) -> list[str | int]:
        return [_key(fields, f) for f in some]

    instruments = []
    for m, names in seen:
        angular = m.seen.kind == "spherical" or m.form not in ("", "matrix", "quaternion")
        turned = [m.seen.turned[i] for i in m.order]
        stated = {
            "readings": [*names],
            "columns": keys(m.seen.position),
            "unit": m.seen.position[0].unit or m.length,
            "turns": keys(turned),
            "angle": m.angle if angular else None,
            "form": m.form,
            "inverted": m.inverted,
            "station": m.seen.station,
            "sd": keys(m.seen.sds),
            "sd_unit": m.seen.sds[0].unit if m.seen.sds else None,
        }
        instruments.append({key: value for key, value in stated.items() if value})
    stated_columns = {
        name: {"column": _key(fields, r.field), "unit": r.unit}
        for name, r in columns.items()
        if r.field is not None
    }
    made: dict[str, Any] = {} if sheet is None else {"sheet": sheet}
    if any(m.seen.station for m, _ in seen):
        made["stations"] = _key(fields, next(f for f in fields.fields if f.stem in STATIONS))
    return {**made, "columns": stated_columns, "instrument": instruments}


def _key(fields: Fields, column: Field) -> str | int:
    """How the table names a column: by its header, by its number where that would be ambiguous."""
    if column.computed:
        return column.label
    same = [i for i, f in enumerate(fields.fields, 1) if f.label == column.label]
    if column.heading and len(same) == 1:
        return column.label
    at = [(f.table, f.position, f.label) for f in fields.fields]
    return 1 + at.index((column.table, column.position, column.label))


def source_fields(paths: Sequence[Any], table: SourceTable) -> Fields:
    """The columns of files or tables in the layout of a source."""
    sources = sources_of_all(tables_of(paths), table.sheet)
    fields = joined(at_rest(sources, [str(c.column) for c in table.columns.values()])[0])
    standing = [f for f in fields.fields if f.stem in STATIONS and len(f.labels) == 1]
    if table.stations is not None or not standing:
        return fields
    # The first files had a row per station and pose; these are of one station.
    (label,) = standing[0].labels
    keys = {key for one in table.instrument for key in (*one.columns, *one.turns, *one.sd)}
    named = [
        replace(f, heading=replace(f.heading, text=f"{f.label}{_OF}{label}"))
        if f.heading and f"{f.label}{_OF}{label}" in keys
        else f
        for f in fields.fields
    ]
    return replace(fields, fields=tuple(named))


def converted(fields: Fields, table: SourceTable, quantities: Set[str]) -> Dataset:
    """These quantities of files in the layout of a source, SI.

    Raises InputError for a column that is missing, and for a station that the table has not.
    """
    readings = {}
    for name, column in table.columns.items():
        if name in quantities:
            field, unit_name = _in_unit(_needed(fields, column.column), column.unit)
            readings[name] = Reading(
                to_si(field.values, unit_name), unit(unit_name).si, field, unit_name
            )
    stations = {} if table.stations is None else _stations(fields, table)
    wanted = [one for one in table.instrument if not quantities.isdisjoint(one.readings)]
    absent = [
        one
        for one in wanted
        if _is_absent(fields, one, table) or not np.any(stations.get(one.station or "", True))
    ]
    for one in wanted:
        if one in absent and len(absent) < len(wanted):
            unread = np.full(len(fields.poses), np.nan)
            for i, name in enumerate(() if one.turns else one.readings):
                si = "rad" if i and one.angle else "m"
                readings[name] = Reading(unread, si, None, si)
            continue
        some = readings_of(_meaning(fields, one, stations), one.readings)
        readings |= {name: r for name, r in some.items() if name in quantities}
    return dataset_of(fields.poses, readings)


def _is_absent(fields: Fields, one: SourceInstrument, table: SourceTable) -> bool:
    """Whether no row is of its station or target, whose label ends its columns, or no column."""
    ends = {f"{_OF}{key.rpartition(_OF)[2]}" for key in map(str, one.columns) if _OF in key}
    if ends:
        return not any(f.label.endswith(tuple(ends)) for f in fields.fields)
    if one.turns or any(_column(fields, key) for key in one.columns):
        return False
    # So many others may be its columns by other names.
    keys = [of.column for of in table.columns.values()]
    keys += [key for other in table.instrument for key in (*other.columns, *other.turns)]
    known = {(f.table, f.position) for key in keys if (f := _column(fields, key))}
    others = [f for f in fields.fields if (f.table, f.position) not in known and f.span]
    return len(others) < len(one.columns)


def _meaning(fields: Fields, one: SourceInstrument, stations: Mapping[str, Rows]) -> Meaning:
    """An instrument of the table, with the columns of these files; stations: the rows of each."""
    position = [_needed(fields, column) for column in one.columns]
    turned = tuple(_needed(fields, column) for column in one.turns)
    if len(position) == 1:
        kind = "length"
    elif turned:
        kind = "pose"
    else:
        kind = "spherical" if one.angle else "point" if len(position) == 3 else "planar"
    spherical = kind == "spherical"
    placed, length = zip(
        *(_in_unit(f, one.angle if spherical and i else one.unit) for i, f in enumerate(position)),
        strict=True,
    )
    form = {4: "quaternion", 9: "matrix"}.get(len(turned), "turns" if turned else "")
    sds = tuple(f for column in one.sd if (f := _column(fields, column)))
    sds = tuple(
        replace(_in_unit(f, one.sd_unit or one.unit)[0], values=f.values / one.coverage)
        for f in sds
    )
    seen = Seen(kind, placed, turned, form, sds if len(sds) == len(one.sd) else ())
    if one.station is not None and one.station in stations:
        seen = at_station(seen, stations[one.station], one.station)
    angle = one.angle or "rad"
    if turned and turned[0].unit and one.angle:
        angle = turned[0].unit
    if spherical:
        angle = length[1]
    order = tuple(range(len(turned)))
    R = turned_by(seen, angle, one.form, order) if turned else None
    at = positions(seen, length[0], angle, one.form)
    made = Meaning(seen, length[0], angle, one.form, order, False, at, R, ())
    return inverse(made) if one.inverted else made


def _in_unit(field: Field, stated: str | None) -> tuple[Field, str]:
    """A column whose header states its unit, and that unit: the header's, else that stated."""
    unit_name = field.unit or stated or "1"
    if field.heading is None:
        return field, unit_name
    return replace(field, heading=replace(field.heading, unit=unit_name)), unit_name


def _column(fields: Fields, key: str | int) -> Field | None:
    """The column of this header or number, of another spelling, or computed as the key says."""
    if isinstance(key, int):
        return fields.fields[key - 1] if key <= len(fields.fields) else None
    exact = [f for f in fields.fields if f.label == key]
    if exact:
        return exact[0].without_unit()  # the project states it, also where this header is wrong
    return computed_column(fields.fields, key)


def _needed(fields: Fields, key: str | int) -> Field:
    column = _column(fields, key)
    if column is None:
        raise InputError(
            f"there is no column {key!r} among {unnamed(fields.fields)}",
            code="missing-column",
            place=fields.sources[0].name,
            remedy="name all files of the day, with the columns of the first ones, which "
            "[data.source] of the project lists; or call columns as the machine calls its joints, "
            "with the unit, such as J1 [deg]",
        )
    return column


def _stations(fields: Fields, table: SourceTable) -> dict[str, Rows]:
    """By station of the table, which rows are of it.

    It stands anew on another day: rows that state no station are of the first, and labels that are
    all new are of the first ones in their order. Raises InputError for other labels.
    """
    named = list(dict.fromkeys(one.station for one in table.instrument if one.station))
    assert table.stations is not None
    column = _column(fields, table.stations)
    if column is None:
        labels = named[:1] * len(fields.poses)
    else:
        labels = [column.words(value) for value in column.values]
    new = [label for label in dict.fromkeys(labels) if label not in named]
    if len(new) == len({*labels}) <= len(named):
        renamed = dict(zip(new, named, strict=False))
        labels = [renamed[label] for label in labels]
    elif new and column is not None:
        raise InputError(
            f"row {labels.index(new[0]) + 1} of the readings is of station {new[0]!r} in the "
            f"column {column.label!r}, and the calibration has {listed(sorted(named))}",
            code="unknown-name",
            remedy="correct the label, or write each station to a separate file",
        )
    return {name: np.array([label == name for label in labels]) for name in named}
