"""Targets as a table: joints in the columns of a result's project, or poses with a seed.

Columns of poses state their unit: `tcp_x [mm]`, `tcp_y [mm]`, `tcp_z [mm]` and `tcp_rz [deg]`,
`tcp_ry [deg]`, `tcp_rx [deg]`, or `tcp_qw`, `tcp_qx`, `tcp_qy`, `tcp_qz`. A column `move` marks
straight lines to a target ("linear").
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import (
    JointAxes,
    pose_of_quaternion,
    pose_of_turns,
    quaternion_of_pose,
    turns_of_pose,
)
from loopcal.companions.robot.programs.dialect import ProgramDialect
from loopcal.companions.robot.programs.program import (
    Move,
    Number,
    Program,
    ProgramTarget,
    Span,
    written,
)
from loopcal.errors import InputError, listed
from loopcal.files.recognition.headers import heading, stem
from loopcal.files.tables.cells import number
from loopcal.files.tables.delimited import WHITESPACE, Dialect, Row, recognise
from loopcal.files.tables.reader import Layout
from loopcal.units import unit

_TURNS = ("tcp_x", "tcp_y", "tcp_z", "tcp_rz", "tcp_ry", "tcp_rx")
_QUATERNION = (*_TURNS[:3], "tcp_qw", "tcp_qx", "tcp_qy", "tcp_qz")
_FINE = 1e-9
"""Last digits that are written at least [SI]."""
_MOST_TURNS = 4
"""Turns of a joint that a table may ask for in radians; wrists turn twice or thrice."""
_MOVES = {"linear": True, "l": True, "movel": True, "joint": False, "j": False, "movej": False}


@dataclass(frozen=True)
class _Cell:
    """A column: its position and the unit of its numbers."""

    at: int
    unit: str

    @property
    def factor(self) -> float:
        return unit(self.unit).factor


def read_table(text: str, name: str, axes: JointAxes) -> Program:
    """The targets of a table. Raises InputError, with the line, for what is no such table."""
    lines = _rows(text)
    rows = [
        Row(n, line) for n, _, line in lines if line.strip(" \t,;") and line.strip()[0] not in "#%"
    ]
    if not rows:
        raise InputError(
            "the table is empty", code="no-data", place=name, remedy="give one row per target"
        )
    delimiter = next((mark for mark in "\t;," if mark in rows[0].line), None)
    dialect = recognise(rows[:100], name, Layout(delimiter=delimiter))
    if rows[-1].number <= dialect.header_row:
        raise InputError(
            "there is a header, but no target",
            code="no-data",
            place=name,
            remedy="give one row per target",
        )
    joints = _joints(dialect, axes, name)
    places, quaternion = _pose_columns(dialect, name)
    if not places and len(joints) < len(axes.joints):
        missing = [j for j in axes.joints if j not in joints]
        raise InputError(
            f"no column holds the joints {listed(missing)}",
            code="missing-column",
            place=name,
            remedy=f"name columns {_wanted(axes)}, or the columns of a pose "
            f"({', '.join(_TURNS[:3])}, ...) with their units",
        )
    at = {n: start for n, start, _ in lines}
    move = next((i for i, n in enumerate(dialect.names) if n.strip().lower() == "move"), None)
    ids = dialect.names.index(str(axes.pose)) if str(axes.pose) in dialect.names else None
    reading = _Reading(dialect, axes, joints, places, quaternion, move, ids, name)
    moved = [reading.target(row, at[row.number]) for row in rows if row.number > dialect.header_row]
    moves = [
        Move(i, target.line, straight, target.literal, target.literal)
        for i, (target, straight) in enumerate(moved)
    ]
    targets = tuple(target for target, _ in moved)
    return Program("table", name, text, targets, (), reading.write, moves=tuple(moves))


def _rows(text: str) -> list[tuple[int, int, str]]:
    """Number, start and line of each; LF, CRLF or CR end a line."""
    # The mark of UTF-8 as Latin-1 shows it: bytes are characters in a program.
    bom = 3 if text.startswith("\xef\xbb\xbf") else 0
    lines = re.compile(r"([^\r\n]*)(?:\r\n|\n|\r|\Z)").finditer(text, bom)
    return [(n, line.start(), line[1]) for n, line in enumerate(lines, 1)]


def _joints(dialect: Dialect, axes: JointAxes, name: str) -> dict[str, _Cell]:
    """The columns of the joints that are there."""
    cells: dict[str, _Cell] = {}
    headings = [heading(n) for n in dialect.names]
    for joint, si in axes.joints.items():
        column = axes.columns.get(joint)
        if column is not None and isinstance(column.column, int) and column.column > 0:
            cells[joint] = _Cell(column.column - 1, column.unit or si)
        elif column is not None and column.column in dialect.names:
            cells[joint] = _Cell(dialect.names.index(str(column.column)), column.unit or si)
        else:
            names = {stem(joint)} | ({heading(str(column.column)).stem} if column else set())
            for i, head in enumerate(headings):
                if head.stem in names:
                    cells[joint] = _Cell(i, head.unit or si)
    for joint, cell in cells.items():
        if unit(cell.unit).si != axes.joints[joint]:
            raise InputError(
                f"the joint {joint!r} is stated in {cell.unit!r}",
                code="wrong-unit",
                place=name,
                remedy=f"give a unit of {axes.joints[joint]}",
            )
    return cells


def _pose_columns(dialect: Dialect, name: str) -> tuple[list[_Cell], bool]:
    """The columns of the pose in their order, and whether it is a quaternion; empty: none."""
    headings = [heading(n) for n in dialect.names]
    by_heading = {head.stem: (i, head.unit) for i, head in enumerate(headings)}
    if not any(n in by_heading for n in _TURNS):
        return [], False
    quaternion = "tcp_qw" in by_heading
    names = _QUATERNION if quaternion else _TURNS
    missing = [n for n in names if n not in by_heading]
    if missing:
        raise InputError(
            f"the pose lacks the columns {listed(missing)}",
            code="missing-column",
            place=name,
            remedy=f"name {', '.join(_TURNS)}, or {', '.join(_QUATERNION)}",
        )
    cells = []
    for n in names:
        i, stated = by_heading[n]
        if stated is None and n not in _QUATERNION[3:]:
            raise InputError(
                f"the column {n!r} states no unit",
                code="unknown-unit",
                place=name,
                remedy=f"name it {n!r} with its unit, such as [mm] or [deg]",
            )
        cells.append(_Cell(i, stated or "1"))
    return cells, quaternion


def _wanted(axes: JointAxes) -> str:
    joint_columns = [axes.columns[j].column if j in axes.columns else j for j in axes.joints]
    return ", ".join(repr(n) for n in joint_columns)


@dataclass(frozen=True, eq=False)
class _Reading:
    """How rows become targets, and targets texts."""

    dialect: Dialect
    axes: JointAxes
    joints: Mapping[str, _Cell]
    places: Sequence[_Cell]
    quaternion: bool
    move: int | None
    ids: int | None
    name: str

    def target(self, row: Row, start: int) -> tuple[ProgramTarget, bool]:
        """The target of a row, and whether the move to it is straight."""
        cells = list(_spans(row.line, self.dialect.delimiter))
        place = f"{self.name}, line {row.number}"
        if len(cells) < self.dialect.width:
            raise InputError(
                f"this row has {len(cells)} cells, where {self.dialect.width} are expected",
                code="invalid-syntax",
                place=place,
                remedy="complete the row",
            )

        def at(cell: _Cell) -> Number:
            begin, end = cells[cell.at]
            text = row.line[begin:end]
            try:
                value = number(text, self.dialect.decimal)
            except ValueError:
                value = float("nan")
            if not np.isfinite(value):
                raise InputError(
                    f"{text!r} is not a number",
                    code="invalid-number",
                    place=place,
                    remedy="give a number, or delete the row",
                )
            return Number(start + begin, start + end, text)

        joint_cells = [self.joints[j] for j in self.axes.joints if j in self.joints]
        seeds = [at(cell) for cell in joint_cells]
        q = np.array([n.value * c.factor for n, c in zip(seeds, joint_cells, strict=True)])
        self._plausible(seeds, joint_cells, place)
        places = [at(cell) for cell in self.places]
        straight = False
        if self.move is not None:
            word = row.line[slice(*cells[self.move])].strip('" ').lower()
            if word not in _MOVES:
                raise InputError(
                    f"the move {word!r} is unknown",
                    code="unknown-name",
                    place=place,
                    remedy="give 'linear' or 'joint'",
                )
            straight = _MOVES[word]
        label = None
        if self.ids is not None:
            begin, end = cells[self.ids]
            label = Number(start + begin, start + end, row.line[begin:end])
        numbers, used = (places, self.places) if places else (seeds, joint_cells)
        target = ProgramTarget(
            label.text if label and label.text else f"row {row.number}",
            row.number,
            bool(places),
            tuple(numbers),
            q if len(joint_cells) == len(self.axes.joints) else None,
            self._pose(places, place) if places else None,
            self._steps(numbers, used),
            literal=Span(start, start + len(row.line)),
            label=label,
        )
        return target, straight

    def _plausible(self, seeds: Sequence[Number], joint_cells: Sequence[_Cell], place: str) -> None:
        """Refuse degrees in a column of radians: no joint turns so often."""
        # 90 deg read as rad are 14 turns; a zero or a small angle shows nothing.
        joints = [joint for joint in self.axes.joints if joint in self.joints]
        for joint, seed, cell in zip(joints, seeds, joint_cells, strict=True):
            turns = abs(seed.value) / (2.0 * np.pi)
            if cell.unit == "rad" and turns > _MOST_TURNS:
                raise InputError(
                    f"the joint {joint!r} is at {seed.text.strip()} rad, {turns:.0f} turns",
                    code="implausible-unit",
                    place=place,
                    remedy=f"if these are degrees, head the column '{joint} [deg]'",
                )

    def _pose(self, places: Sequence[Number], place: str) -> Array:
        values = [n.value * c.factor for n, c in zip(places, self.places, strict=True)]
        if self.quaternion:
            return pose_of_quaternion([*(1e3 * v for v in values[:3]), *values[3:]], place)
        return pose_of_turns([*(1e3 * v for v in values[:3]), *np.degrees(values[3:])])

    def _steps(self, numbers: Sequence[Number], cells: Sequence[_Cell]) -> Array:
        steps = [10.0 ** -_decimals(n, c) * c.factor for n, c in zip(numbers, cells, strict=True)]
        if self.places and self.quaternion:
            # A change dq of a unit quaternion turns by 2 |dq|.
            steps = [*steps[:3], *[2.0 * max(steps[3:])] * 3]
        return np.array(steps)

    def write(self, target: ProgramTarget, joints: Array, pose: Array) -> list[str]:
        """The new texts of a row's numbers."""
        if not target.cartesian:
            cells = [self.joints[j] for j in self.axes.joints]
            values = [v / c.factor for v, c in zip(joints.tolist(), cells, strict=True)]
        else:
            cells = list(self.places)
            if self.quaternion:
                parts = quaternion_of_pose(pose, [n.value for n in target.numbers])
                values = [1e-3 * v / c.factor for v, c in zip(parts[:3], cells[:3], strict=True)]
                values += parts[3:]
            else:
                parts = turns_of_pose(pose)
                si = [*(1e-3 * v for v in parts[:3]), *np.radians(parts[3:])]
                values = [v / c.factor for v, c in zip(si, cells, strict=True)]
        texts = [
            written(v, _decimals(n, c))
            for v, n, c in zip(values, target.numbers, cells, strict=True)
        ]
        return [t.replace(".", self.dialect.decimal) for t in texts]


def _decimals(number: Number, cell: _Cell) -> int:
    """As many as the number has, and enough for a nanometre or a nanoradian."""
    least = int(np.ceil(-np.log10(_FINE / cell.factor)))
    return max(number.decimals, least, 0)


def _spans(line: str, delimiter: str) -> Iterator[tuple[int, int]]:
    """Where the cells of a row begin and end, without blanks around them and quotes."""
    if delimiter == WHITESPACE:
        pattern = r'"[^"]*"|[^\s"]+'
        spans = [(m.start(), m.end()) for m in re.finditer(pattern, line)]
    else:
        escaped = re.escape(delimiter)
        # Possessive: a row of quotes cannot make the match back out (docs/decisions/0137).
        pattern = rf'((?:"[^"]*+(?:"|$)|[^{escaped}"])*+)(?:{escaped}|$)'
        spans = []
        for m in re.finditer(pattern, line):
            spans.append((m.start(1), m.end(1)))
            if m.end() == len(line) and not line.endswith(delimiter):
                break
    for start, end in spans:
        while start < end and line[start] in ' \t"':
            start += 1
        while start < end and line[end - 1] in ' \t"':
            end -= 1
        yield start, end


DIALECT = ProgramDialect(
    "table", "joints, or poses", "seed columns", (".csv", ".tsv", ".txt"), read_table
)
