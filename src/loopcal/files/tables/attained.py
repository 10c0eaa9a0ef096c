"""Commanded and attained poses from a table, its columns recognised by their headers.

A header names an axis (x, y, z; roll, pitch, yaw; a, b, c; rx, ry, rz; qw, qx, qy, qz), with "cmd",
"nominal" or the like for commanded values, and its unit: "x_cmd [mm]", "x [mm]". Further columns
are pose, cycle, direction, block, time, payload and speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, nearest
from loopcal.files.recognition.headers import Heading, heading
from loopcal.files.recognition.vocabulary import meanings, words
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.table import Table
from loopcal.measurements.attained import AttainedPoses
from loopcal.measurements.source import row_name
from loopcal.units import to_si, unit

Array = NDArray[np.float64]
ANGLES = ("rpy", "zyx", "rotvec")
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
_IDS = frozenset(("id", "no", "nr", "number", "name", "index"))
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
            raise InputError(
                f"the convention of angles {angles!r} is not known",
                code="unknown-name",
                remedy=nearest(angles, ANGLES),
            )
        dimension_units: dict[str, str] = {}
        for name in () if units is None else units.split(","):
            stated_unit = unit(name)
            if (
                stated_unit.dimension not in ("length", "angle")
                or stated_unit.dimension in dimension_units
            ):
                raise InputError(
                    f"units {units!r} are not one length, one angle or both",
                    code="wrong-unit",
                    remedy='give the units of positions and angles, say "mm,deg"',
                )
            dimension_units[stated_unit.dimension] = stated_unit.name
        return cls(dimension_units, angles, ask)


@dataclass(eq=False)
class _Columns:
    """A table with the position of each recognised column: ("cmd" or "", axis), or a label."""

    table: Table
    at: dict[tuple[str, str], int] = field(default_factory=dict)
    headings: dict[int, Heading] = field(default_factory=dict)

    @classmethod
    def of(cls, path: str | Path) -> _Columns:
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
        made = cls(table)
        for position, name in enumerate(table.names):
            header = heading(name)
            made.headings[position] = header
            role = _role(header.stem)
            if role is None:
                continue
            if role in made.at:
                other = table.label(made.at[role])
                raise InputError(
                    f"the columns {other!r} and {table.label(position)!r} mean the same",
                    code="duplicate-column",
                    place=table.name,
                    remedy="rename or remove one of them",
                )
            made.at[role] = position
        return made

    def __len__(self) -> int:
        return len(self.table.rows)

    def place(self, row: int, position: int | None = None) -> str:
        """File, row and column for a message."""
        where = f"{self.table.name}, {row_name(int(self.table.rows[row]), self.table.begins)}"
        return where if position is None else f"{where}, column {self.table.label(position)!r}"

    def has(self, kind: str, names: Sequence[str]) -> bool:
        return all((kind, name) in self.at for name in names)

    def has_position(self, kind: str, planar: bool) -> bool:
        return self.has(kind, _POSITION[:2] if planar else _POSITION)

    def position(self, kind: str, planar: bool, stated: _Stated) -> Array:
        """(N, 3) [m]; z is 0 in a plane."""
        if not planar:
            return self.numbers(kind, _POSITION, "length", stated)
        return np.pad(self.numbers(kind, _POSITION[:2], "length", stated), ((0, 0), (0, 1)))

    def numbers(self, kind: str, names: Sequence[str], si: str, stated: _Stated) -> Array:
        """Columns (N, k) in SI; si: "length", "angle" or "number"."""
        columns = []
        for name in names:
            position = self.at[(kind, name)]
            values = self.table.numbers(position, np.arange(len(self)))
            columns.append(
                values if si == "number" else to_si(values, self._unit(position, stated))
            )
            if si != "number" and unit(self._unit(position, stated)).dimension != si:
                raise InputError(
                    f"the unit is {self._unit(position, stated)!r}, which is no {si}",
                    code="wrong-unit",
                    place=f"{self.table.name}, column {self.table.label(position)!r}",
                    remedy=f"state a unit of {si}",
                )
        return np.array(columns).T

    def _unit(self, position: int, stated: _Stated) -> str:
        stated_unit = self.headings[position].unit
        if stated_unit is not None:
            return stated_unit
        axis = _role(self.headings[position].stem)
        dimension = "length" if axis is not None and axis[1] in _POSITION else "angle"
        if dimension not in stated.units and stated.ask is not None:
            offered = _OFFERED[dimension]
            label = self.table.label(position)
            chosen = stated.ask(f"Which unit has {label!r} of {self.table.name}?", offered)
            # The answer holds for all columns of this dimension.
            stated.units[dimension] = offered[chosen]
        if dimension in stated.units:
            return stated.units[dimension]
        raise InputError(
            "the header states no unit",
            code="unknown-unit",
            place=f"{self.table.name}, column {self.table.label(position)!r}",
            remedy=f'write it into the header, say "{self.table.label(position)} '
            f'[{"mm" if dimension == "length" else "deg"}]", or state --units mm,deg',
        )

    def ids(self, label: str) -> tuple[str, ...] | None:
        """A column of labels; InputError for an empty cell."""
        position = self.at.get(("", label))
        if position is None:
            return None
        labels = self.table.ids(position)
        empty = [i for i, text in enumerate(labels) if text in ("", "None", "nan")]
        if empty:
            raise InputError(
                f"the cell of {label} is empty",
                code="missing-reading",
                place=self.place(empty[0], position),
                remedy="fill it in, or remove the row",
            )
        return labels

    def orientation(self, kind: str, stated: _Stated) -> Array | None:
        """Rotation matrices (N, 3, 3), NaN where an angle is missing; None without columns."""
        for names, means in _FORMS.items():
            present = [name for name in names if (kind, name) in self.at]
            if not present:
                continue
            if len(present) < len(names):
                missing = [name for name in names if name not in present]
                raise InputError(
                    f"an orientation has {listed(present)}, but not {listed(missing)}",
                    code="missing-column",
                    place=self.table.name,
                    remedy="give all its columns, or none",
                )
            if not means and stated.angles is None and stated.ask is not None:
                question = f"What do {', '.join(names)} of {self.table.name} mean?"
                stated.angles = ANGLES[stated.ask(question, _MEANINGS)]
            form = means or stated.angles
            if form is None:
                raise InputError(
                    f"the columns {', '.join(names)} can mean different orientations",
                    code="conflicting-keys",
                    place=self.table.name,
                    remedy="state --angles rpy (turns about fixed x, y, z), zyx (A about z, B "
                    "about y, C about x, as KUKA writes) or rotvec (rotation vector)",
                )
            values = self.numbers(kind, names, "number" if len(names) == 4 else "angle", stated)
            return rotations(values, form)
        return None


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
    plain = len(words) == 1 or words[1] in _IDS
    return ("", label) if plain or label in (*_CONDITIONS, "time", "direction") else None


def rotations(values: Array, form: str) -> Array:
    """Rotation matrices (N, 3, 3) of quaternions w, x, y, z or of three angles [rad].

    form: "quaternion"; "rpy", turns about the fixed axes x, y, z; "zyx", turns about z, the new y
    and the newest x; "rotvec". Rows with a missing value are NaN.
    """
    from scipy.spatial.transform import Rotation

    complete = np.isfinite(values).all(axis=1)
    if form == "quaternion":
        # SciPy refuses a quaternion of length 0.
        complete &= np.linalg.norm(values, axis=1) > 0.0
    matrices = np.full((len(values), 3, 3), np.nan)
    if complete.any():
        complete_values = values[complete]
        if form == "quaternion":
            # scipy has w last
            made = Rotation.from_quat(complete_values[:, [1, 2, 3, 0]])
        elif form == "rotvec":
            made = Rotation.from_rotvec(complete_values)
        else:
            made = Rotation.from_euler("xyz" if form == "rpy" else "ZYX", complete_values)
        matrices[complete] = made.as_matrix()
    return matrices


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
    read = _Columns.of(path)
    planar = not any((kind, "z") in read.at for kind in ("", "cmd"))
    if not read.has_position("", planar):
        raise _no_columns(read, "measured", "")
    measured = read.position("", planar, stated)
    turns = read.orientation("", stated)
    pose = read.ids("pose")
    if commanded is None:
        if not read.has_position("cmd", planar):
            raise _no_columns(read, "commanded", "_cmd")
        asked = read.position("cmd", planar, stated)
        asked_turns = read.orientation("cmd", stated)
    else:
        asked, asked_turns = _from_table(read, pose, _Columns.of(commanded), stated, planar)
    _refuse_unknown(read, asked)
    if pose is None:
        pose = _poses_by_place(asked)
    _refuse_two_places(read, pose, asked)
    both = [measured] if turns is None else [measured, turns.reshape(len(turns), 9)]
    keep = np.asarray(np.isfinite(np.hstack(both)).all(axis=1))
    notes = _left_out(read, keep)
    if not keep.any():
        raise InputError(
            "no row has a measured pose",
            code="no-data",
            place=read.table.name,
            remedy="fill in the measured columns",
        )
    if turns is None or asked_turns is None:
        if (turns is None) != (asked_turns is None):
            oriented = "commanded" if turns is None else "measured"
            notes.append(f"Only the {oriented} poses have an orientation; it is not used.")
        turns = asked_turns = None
    made = _assembled(read, pose, notes, keep, (asked, measured, asked_turns, turns))
    if not planar:
        return made
    words = "The table has no z: all figures are those of the plane of x and y."
    return replace(made, planar=True, notes=(words, *made.notes))


def _assembled(
    read: _Columns,
    pose: tuple[str, ...],
    notes: list[str],
    keep: NDArray[np.bool_],
    arrays: tuple[Array, Array, Array | None, Array | None],
) -> AttainedPoses:
    rows = np.flatnonzero(keep)

    def kept(labels: tuple[str, ...] | None) -> tuple[str, ...] | None:
        return None if labels is None else tuple(labels[i] for i in rows)

    conditions = {
        read.table.label(read.at[("", name)]): kept(read.ids(name)) or ()
        for name in _CONDITIONS
        if ("", name) in read.at
    }
    direction, block, cycle = (read.ids(name) for name in ("direction", "block", "cycle"))
    apart = (direction, block, *map(read.ids, _CONDITIONS))
    groups = [*zip(pose, *(labels for labels in apart if labels is not None), strict=True)]
    if cycle is None:
        notes.append("The table has no cycle column: the rows of a pose count as its cycles.")
        seen: dict[tuple[str, ...], int] = {}
        counted = []
        for group in groups:
            seen[group] = seen.get(group, 0) + 1
            counted.append(str(seen[group]))
        cycle = tuple(counted)
    _refuse_repeated(read, groups, cycle)
    asked, measured, asked_turns, turns = arrays
    time = _times(read)
    return AttainedPoses(
        read.table.name,
        tuple(pose[i] for i in rows),
        tuple(cycle[i] for i in rows),
        asked[rows],
        measured[rows],
        None if asked_turns is None else asked_turns[rows],
        None if turns is None else turns[rows],
        kept(direction),
        kept(block),
        None if time is None else time[rows],
        conditions,
        tuple(notes),
    )


def _from_table(
    read: _Columns,
    pose: tuple[str, ...] | None,
    table: _Columns,
    stated: _Stated,
    planar: bool,
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
    if not table.has_position(kind, planar) or (planar and (kind, "z") in table.at):
        raise _no_columns(table, "commanded", "")
    if len(set(names)) < len(names):
        twice = next(i for i, name in enumerate(names) if name in names[:i])
        raise InputError(
            f"the pose {names[twice]!r} is there twice",
            code="duplicate-name",
            place=table.place(twice),
            remedy="give each commanded pose once",
        )
    at = {name: i for i, name in enumerate(names)}
    for row, name in enumerate(pose):
        if name not in at:
            raise InputError(
                f"the pose {name!r} is not among the commanded ones",
                code="mismatched-poses",
                place=read.place(row),
                remedy=nearest(name, at),
            )
    index = [at[name] for name in pose]
    turns = table.orientation(kind, stated)
    positions = table.position(kind, planar, stated)
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
                    place=read.place(row, position),
                    remedy="write 2026-03-01T08:30:00, or numbers under time [s], [min] or [h]",
                ) from None
            # without a zone, so that no change of clocks in the night stretches an hour
            seconds.append((at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp())
        return np.array(seconds) - min(seconds)
    header = read.headings[position]
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
            place=read.place(int(unknown[0]), position),
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


def _no_columns(read: _Columns, what: str, ending: str) -> InputError:
    return InputError(
        f"the columns of the {what} position are missing",
        code="missing-column",
        place=read.table.name,
        remedy=f"name them x{ending} [mm], y{ending} [mm], z{ending} [mm]"
        + (", or give a table of commanded poses (--commanded)" if ending else "")
        + f"; the columns are {listed(read.table.names, 40)}",
    )


def _refuse_unknown(read: _Columns, asked: Array) -> None:
    unknown = np.flatnonzero(~np.isfinite(asked).all(axis=1))
    if unknown.size:
        raise InputError(
            "the commanded position is missing",
            code="missing-reading",
            place=read.place(int(unknown[0])),
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
                place=read.place(row),
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
                place=read.place(row),
                remedy="number the cycles, or add a column that separates them (direction, block, "
                "payload, speed)",
            )


def _left_out(read: _Columns, keep: NDArray[np.bool_]) -> list[str]:
    gone = np.flatnonzero(~keep)
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
