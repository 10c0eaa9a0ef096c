"""Commanded and attained poses from a table, its columns recognised by their headers.

A header names an axis (x, y, z; roll, pitch, yaw; a, b, c; rx, ry, rz; qw, qx, qy, qz), with "cmd",
"nominal" or the like for commanded values, and its unit: "x_cmd [mm]", "x [mm]". Further columns
are pose, cycle, direction, block, time, payload and speed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, listed, nearest, refuse_repeated, unknown_name
from loopcal.files.recognition.headers import heading, meanings, words
from loopcal.files.recognition.meanings import rotations
from loopcal.files.tables.readers import NAMELESS, read_table
from loopcal.files.tables.table import Table
from loopcal.measurements.attained import AttainedPoses
from loopcal.units import to_si, unit

ANGLES = {"rpy": "xyz", "zyx": "ZYX", "rotvec": "rotation-vector"}
"""What three angles may mean -> the form of `rotations`."""
_POSITION = ("x", "y", "z")
_FORMS = {
    ("qw", "qx", "qy", "qz"): "quaternion",
    ("roll", "pitch", "yaw"): "rpy",
    ("w", "p", "r"): "rpy",
    ("a", "b", "c"): "",
    ("rx", "ry", "rz"): "",
}
"""Names of the columns of an orientation and what they mean; empty where the user must state it."""
_AXES = frozenset(_POSITION).union(*_FORMS)
_COMMANDED = frozenset(words("performance", "commanded"))
_MEASURED = frozenset(words("performance", "measured"))
_LABELS = meanings("performance_labels")
_COUNTED = words("performance", "counted")
_CONDITIONS = ("payload", "speed")
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}
TOGETHER = 1e-6
"""Commanded positions [m] of one pose differ by less."""
TEMPLATE = "performance.csv"


Ask = Callable[[str, Sequence[str]], int]
"""Asks a person which answer is right."""
_OFFERED = {"length": ("mm", "m", "in"), "angle": ("deg", "rad")}
_MEANINGS = (
    "turns about fixed x, y, z",
    "A about z, B about y, C about x (KUKA)",
    "rotation vector",
)


@dataclass
class _Stated:
    """What the user states: units by dimension, and the convention of three angles; ask: for what
    is not stated, None where no person is."""

    units: dict[str, str]
    angles: str | None
    ask: Ask | None

    @classmethod
    def of(cls, units: str | None, angles: str | None, ask: Ask | None) -> _Stated:
        if angles is not None and angles not in ANGLES:
            raise unknown_name(f"the convention of angles {angles!r} is not known", angles, ANGLES)
        named = [] if units is None else [unit(name) for name in units.split(",")]
        by_dimension = {one.dimension: one.name for one in named}
        if len(by_dimension) < len(named) or not by_dimension.keys() <= _OFFERED.keys():
            raise InputError(
                f"units {units!r} are not one length, one angle or both",
                code="wrong-unit",
                remedy='give the units of positions and angles, say "mm,deg"',
            )
        return cls(by_dimension, angles, ask)


@dataclass(eq=False)
class _Columns:
    """A table with the position of each recognised column: ("cmd" or "", axis), or a label."""

    table: Table
    stated: _Stated
    at: dict[tuple[str, str], int] = field(default_factory=dict)

    @classmethod
    def of(cls, path: str | Path, stated: _Stated) -> _Columns:
        table = read_table(path)
        if not table.names:
            raise InputError(
                "the table has no header",
                code="missing-column",
                place=table.name,
                remedy="name the columns: pose, cycle, x_cmd [mm], x [mm], ... "
                "(`loopcal new NAME --performance` writes an example)",
            )
        if not len(table.rows):
            raise InputError(
                "the table has no rows",
                code="no-data",
                place=table.name,
                remedy="give a row per measurement",
            )
        made = cls(table, stated)
        for position, name in enumerate(table.names):
            role = _role(heading(name).stem)
            if role is not None and made.at.setdefault(role, position) != position:
                other = table.label(made.at[role])
                raise InputError(
                    f"the columns {other!r} and {table.label(position)!r} mean the same",
                    code="duplicate-column",
                    place=table.name,
                    remedy="rename or remove one of them",
                )
        return made

    def __len__(self) -> int:
        return len(self.table.rows)

    def has_position(self, kind: str, planar: bool) -> bool:
        return all((kind, name) in self.at for name in (_POSITION[:2] if planar else _POSITION))

    def poses(self, kind: str, what: str, planar: bool) -> tuple[Array, Array | None]:
        """Positions (N, 3) [m], z 0 in a plane, and rotation matrices (N, 3, 3), None without.

        Raises InputError without columns of positions.
        """
        if not self.has_position(kind, planar):
            raise self.no_position(f"_{kind}" if kind else "", what)
        position = self._numbers(kind, _POSITION[:2] if planar else _POSITION, "length")
        spatial = np.pad(position, ((0, 0), (0, 3 - position.shape[1])))
        return spatial, self._orientation(kind)

    def no_position(self, ending: str, what: str) -> InputError:
        """The error for missing columns of positions; ending: of their names."""
        return InputError(
            f"the columns of the {what} position are missing",
            code="missing-column",
            place=self.table.name,
            remedy=f"name them x{ending} [mm], y{ending} [mm], z{ending} [mm]"
            + (", or give a table of commanded poses (--commanded)" if ending else "")
            + f"; the columns are {listed(self.table.names, 40)}",
        )

    def _numbers(self, kind: str, names: Sequence[str], dimension: str) -> Array:
        """Columns (N, k) in SI, those of no dimension as they are."""
        positions = [self.at[(kind, name)] for name in names]
        columns = [self.table.numbers(position, np.arange(len(self))) for position in positions]
        if dimension:
            units = [self._unit(position, dimension) for position in positions]
            columns = [to_si(column, one) for column, one in zip(columns, units, strict=True)]
        return np.array(columns).T

    def _unit(self, position: int, dimension: str) -> str:
        label, units, ask = self.table.label(position), self.stated.units, self.stated.ask
        place = f"{self.table.name}, column {label!r}"
        stated_unit = heading(self.table.names[position]).unit
        if stated_unit is None and dimension not in units and ask is not None:
            # The answer holds for all columns of this dimension.
            number = ask(f"Which unit has {label!r} of {self.table.name}?", _OFFERED[dimension])
            units[dimension] = _OFFERED[dimension][number]
        chosen = stated_unit or units.get(dimension)
        if chosen is None:
            raise InputError(
                "the header states no unit",
                code="unknown-unit",
                place=place,
                remedy=f'write it into the header, say "{label} [{_OFFERED[dimension][0]}]", or '
                "state --units mm,deg",
            )
        if unit(chosen).dimension != dimension:
            raise InputError(
                f"the unit is {chosen!r}, which is no {dimension}",
                code="wrong-unit",
                place=place,
                remedy=f"state a unit of {dimension}",
            )
        return chosen

    def ids(self, label: str) -> tuple[str, ...] | None:
        """A column of labels; InputError for an empty cell."""
        position = self.at.get(("", label))
        if position is None:
            return None
        labels = self.table.ids(position)
        empty = [i for i, text in enumerate(labels) if text in NAMELESS]
        if empty:
            raise InputError(
                f"the cell of {label} is empty",
                code="missing-reading",
                place=self.table.place(empty[0], position),
                remedy="fill it in, or remove the row",
            )
        return labels

    def _orientation(self, kind: str) -> Array | None:
        """Rotation matrices (N, 3, 3), NaN where an angle is missing; None without columns."""
        for names, means in _FORMS.items():
            missing = [name for name in names if (kind, name) not in self.at]
            if len(missing) == len(names):
                continue
            if missing:
                present = [name for name in names if name not in missing]
                raise InputError(
                    f"an orientation has {listed(present)}, but not {listed(missing)}",
                    code="missing-column",
                    place=self.table.name,
                    remedy="give all its columns, or none",
                )
            if means == "quaternion":
                return rotations(self._numbers(kind, names, ""), means)
            numbers = self._numbers(kind, names, "angle")
            return rotations(numbers, ANGLES[means or self._convention(names)])
        return None

    def _convention(self, names: Sequence[str]) -> str:
        """What three angles mean that people write in several ways."""
        stated = self.stated
        if stated.angles is None and stated.ask is not None:
            question = f"What do {', '.join(names)} of {self.table.name} mean?"
            stated.angles = [*ANGLES][stated.ask(question, _MEANINGS)]
        if stated.angles is None:
            raise InputError(
                f"the columns {', '.join(names)} can mean different orientations",
                code="conflicting-keys",
                place=self.table.name,
                remedy="state --angles rpy (turns about fixed x, y, z), zyx (A about z, B "
                "about y, C about x, as KUKA writes) or rotvec (rotation vector)",
            )
        return stated.angles


def _role(stem: str) -> tuple[str, str] | None:
    """("cmd" or "", axis) of a column of poses, ("", label) of others, None for neither."""
    words = stem.split("_")
    marks = [word for word in words if word in _COMMANDED | _MEASURED]
    rest = [word for word in words if word not in marks]
    if len(rest) == 1 and rest[0] in _AXES and len(marks) < 2:
        return ("cmd" if marks and marks[0] in _COMMANDED else "", rest[0])
    label = _LABELS.get(words[0])
    if label is None or any(word in _AXES for word in words[1:]):
        return None
    plain = len(words) == 1 or words[1] in _COUNTED
    return ("", label) if plain or label in (*_CONDITIONS, "time", "direction") else None


def read_attained(
    path: str | Path,
    *,
    commanded: str | Path | None = None,
    units: str | None = None,
    angles: str | None = None,
    ask: Ask | None = None,
) -> AttainedPoses:
    """Attained poses from CSV, XLSX or Parquet.

    commanded: a table of pose, x, y, z (and an orientation), where the commanded poses are not in
    the same table. units: of columns whose header states none, "mm,deg". angles: what columns a, b,
    c or rx, ry, rz mean, "rpy", "zyx" or "rotvec". ask: asks a person for what is not stated.
    Raises InputError with file, row and column.
    """
    stated = _Stated.of(units, angles, ask)
    read = _Columns.of(path, stated)
    planar = not any((kind, "z") in read.at for kind in ("", "cmd"))
    measured, turns = read.poses("", "measured", planar)
    pose = read.ids("pose")
    if commanded is None:
        asked, asked_turns = read.poses("cmd", "commanded", planar)
    else:
        asked, asked_turns = _from_table(read, pose, _Columns.of(commanded, stated), planar)
    _refuse_unknown(read, asked)
    if pose is None:
        pose = _poses_by_place(asked)
    _refuse_two_places(read, pose, asked)
    both = [measured] if turns is None else [measured, turns.reshape(len(turns), 9)]
    rows = np.flatnonzero(np.isfinite(np.hstack(both)).all(axis=1))
    if not rows.size:
        raise InputError(
            "no row has a measured pose",
            code="no-data",
            place=read.table.name,
            remedy="fill in the measured columns",
        )
    notes = _left_out(read, rows)
    if (turns is None) != (asked_turns is None):
        oriented = "commanded" if turns is None else "measured"
        notes.append(f"Only the {oriented} poses have an orientation; it is not used.")
        turns = asked_turns = None
    if planar:
        notes.insert(0, "The table has no z: all figures are those of the plane of x and y.")
    labels = {name: read.ids(name) for name in ("direction", "block", *_CONDITIONS)}
    apart = [label for label in labels.values() if label is not None]
    groups = [*zip(pose, *apart, strict=True)]
    cycle = read.ids("cycle")
    if cycle is None:
        notes.append("The table has no cycle column: the rows of a pose count as its cycles.")
        cycle = tuple(map(str, _counted(groups)))
    _refuse_repeated(read, groups, cycle)
    time = _times(read)

    def kept(of_rows: Sequence[str]) -> tuple[str, ...]:
        return tuple(of_rows[i] for i in rows.tolist())

    by_name = {name: kept(label) for name, label in labels.items() if label is not None}
    return AttainedPoses(
        read.table.name,
        kept(pose),
        kept(cycle),
        asked[rows],
        measured[rows],
        None if asked_turns is None else asked_turns[rows],
        None if turns is None else turns[rows],
        by_name.get("direction"),
        by_name.get("block"),
        None if time is None else time[rows],
        {read.table.label(read.at["", n]): by_name[n] for n in _CONDITIONS if n in by_name},
        tuple(notes),
        planar,
    )


def _counted(groups: Sequence[tuple[str, ...]]) -> list[int]:
    """How often each group has come, this time included."""
    seen: Counter[tuple[str, ...]] = Counter()
    numbers = []
    for group in groups:
        seen[group] += 1
        numbers.append(seen[group])
    return numbers


def _from_table(
    read: _Columns, pose: tuple[str, ...] | None, table: _Columns, planar: bool
) -> tuple[Array, Array | None]:
    """Commanded positions and orientations of each row, from a table of poses."""
    names = table.ids("pose")
    if pose is None or names is None:
        raise InputError(
            "the column pose is missing",
            code="missing-column",
            place=(table if pose is not None else read).table.name,
            remedy="name the pose in both tables",
        )
    kind = "cmd" if table.has_position("cmd", planar) else ""
    if planar and (kind, "z") in table.at:
        raise table.no_position("", "commanded")
    positions, turns = table.poses(kind, "commanded", planar)
    once = "give each commanded pose once"
    refuse_repeated(names, "the pose {!r} is there twice", once, table.table.place)
    at = {name: i for i, name in enumerate(names)}
    for row, name in enumerate(pose):
        if name not in at:
            raise InputError(
                f"the pose {name!r} is not among the commanded ones",
                code="mismatched-poses",
                place=read.table.place(row),
                remedy=nearest(name, at),
            )
    index = [at[name] for name in pose]
    return positions[index], None if turns is None else turns[index]


def _times(read: _Columns) -> Array | None:
    """Times [s] from numbers with a unit, or from dates as ISO 8601 writes them."""
    position = read.at.get(("", "time"))
    if position is None:
        return None
    if position not in read.table.numeric():
        cells = read.table.ids(position)
        seconds = []
        for row, cell in enumerate(cells):
            try:
                at = datetime.fromisoformat(cell)
            except ValueError:
                raise InputError(
                    f"{cell!r} is not a time",
                    code="invalid-value",
                    place=read.table.place(row, position),
                    remedy="write 2026-03-01T08:30:00, or numbers under time [s], [min] or [h]",
                ) from None
            # without a zone, so that no change of clocks in the night stretches an hour
            seconds.append((at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp())
        return np.array(seconds) - min(seconds)
    header = heading(read.table.names[position])
    word = header.unit or header.stem.rpartition("_")[2]
    if word not in _SECONDS:
        raise InputError(
            "the header of the time states no unit",
            code="unknown-unit",
            place=f"{read.table.name}, column {read.table.label(position)!r}",
            remedy="write time [s], time [min] or time [h]",
        )
    values = read.table.numbers(position, np.arange(len(read))) * _SECONDS[word]
    unknown = np.flatnonzero(~np.isfinite(values))
    if unknown.size:
        raise InputError(
            "the time is missing",
            code="missing-reading",
            place=read.table.place(int(unknown[0]), position),
            remedy="fill it in, or remove the row",
        )
    return np.asarray(values, dtype=np.float64)


def _poses_by_place(asked: Array) -> tuple[str, ...]:
    """Poses counted by their commanded positions, in the order of the table."""
    seen: dict[tuple[int, ...], str] = {}
    return tuple(
        seen.setdefault(tuple(np.round(p / TOGETHER).astype(int).tolist()), f"P{len(seen) + 1}")
        for p in asked
    )


def _refuse_unknown(read: _Columns, asked: Array) -> None:
    unknown = np.flatnonzero(~np.isfinite(asked).all(axis=1))
    if unknown.size:
        raise InputError(
            "the commanded position is missing",
            code="missing-reading",
            place=read.table.place(int(unknown[0])),
            remedy="fill it in, or remove the row",
        )


def _refuse_two_places(read: _Columns, pose: tuple[str, ...], asked: Array) -> None:
    first: dict[str, int] = {}
    for row, name in enumerate(pose):
        at = first.setdefault(name, row)
        if not math.dist(asked[row], asked[at]) <= TOGETHER:
            raise InputError(
                f"the pose {name!r} has another commanded position than in row "
                f"{int(read.table.rows[at])}",
                code="mismatched-poses",
                place=read.table.place(row),
                remedy="name the poses apart, or correct the commanded position",
            )


def _refuse_repeated(
    read: _Columns, groups: Sequence[tuple[str, ...]], cycle: tuple[str, ...]
) -> None:
    seen: dict[tuple[str, ...], int] = {}
    for row, (group, number) in enumerate(zip(groups, cycle, strict=True)):
        other = seen.setdefault((*group, number), row)
        if other != row:
            raise InputError(
                f"cycle {number!r} of the pose {group[0]!r} is there already, in row "
                f"{int(read.table.rows[other])}",
                code="duplicate-name",
                place=read.table.place(row),
                remedy="number the cycles, or add a column that separates them (direction, block, "
                "payload, speed)",
            )


def _left_out(read: _Columns, kept: NDArray[np.intp]) -> list[str]:
    gone = np.setdiff1d(np.arange(len(read)), kept)
    if not gone.size:
        return []
    rows = ", ".join(str(int(read.table.rows[i])) for i in gone[:5])
    more = f" and {gone.size - 5} more" if gone.size > 5 else ""
    return [f"Without a measured pose, and left out: row {rows}{more}."]


def template() -> str:
    """A table to fill in: five poses in the inclined plane of a cube, 30 cycles."""
    lines = ["pose,cycle,x_cmd [mm],y_cmd [mm],z_cmd [mm],x [mm],y [mm],z [mm]"]
    # 0.8 of the half diagonal: P2 to P5 lie a tenth of the diagonal from its ends (ISO 9283).
    half = 200.0
    corners = [(0, 0, 0), (1, 1, 1), (-1, 1, 1), (-1, -1, -1), (1, -1, -1)]
    for cycle in range(1, 31):
        for number, (a, b, c) in enumerate(corners, 1):
            x, y, z = 1000.0 + 0.8 * half * a, 0.8 * half * b, 800.0 + 0.8 * half * c
            lines.append(f"P{number},{cycle},{x:g},{y:g},{z:g},,,")
    return "\n".join(lines) + "\n"
