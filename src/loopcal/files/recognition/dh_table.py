"""Tables of Denavit-Hartenberg parameters: a row per joint, columns a, d, alpha and theta."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.files.recognition.framed import framed_table, turned_over
from loopcal.files.recognition.headers import Heading, heading, meanings, words
from loopcal.files.recognition.robot_listings import called_robot, listed_robot, without_robot
from loopcal.files.tables.cells import is_missing
from loopcal.units import unit

_KEYS = meanings("dh")
_PREFIX = "dh_"
_TEXTS = ("name", "kind", "form", "body", "parent")
_LENGTHS_AND_TWIST = ("a", "d", "alpha")
"""Columns that every table has."""
_CELL = re.compile(
    r"(?P<variable>(?!pi)[a-zθϑ][a-zθϑ_]*_?\d*\*?)?\s*(?P<sign>[-+])?\s*"
    r"(?P<number>\d+\.?\d*(?:e[-+]?\d+)?|\.\d+)?\s*\*?\s*"
    r"(?P<pi>pi)?(?:\s*/\s*(?P<below>[1-9]\d*))?\s*(?P<unit>°|deg|rad)?"
)
_MODIFIED = meanings("dh_modified")
_KINDS = {"": "revolute", **meanings("joint_kinds")}
# Two decades: m and mm, which differ by three, can never both be plausible.
SMALLEST, LARGEST = 0.1, 10.0
"""Sums of all lengths of a machine that are plausible [m]."""


@dataclass(frozen=True)
class Row:
    """One row: lengths [m], angles [rad]; kind: "revolute", "prismatic" or "fixed"; body, parent:
    of a tree, what it ties."""

    name: str
    a: float
    d: float
    alpha: float
    offset: float
    kind: str = "revolute"
    direction: int = 1
    body: str = ""
    parent: str = ""

    def turned(self, sign: int) -> Row:
        """The row of a joint that counts the other way round where sign is -1."""
        return replace(self, direction=self.direction * sign)


@dataclass(frozen=True)
class DhTable:
    """A machine by its rows; modified: of the convention of Craig; remarks: what was inferred;
    stated: whether the file says which convention."""

    rows: tuple[Row, ...]
    modified: bool
    remarks: tuple[str, ...]
    stated: bool = False

    @property
    def moving(self) -> int:
        """How many joints move."""
        return sum(row.kind != "fixed" for row in self.rows)


def is_dh(path: str | Path) -> bool:
    """Whether a text file or workbook is a table of Denavit-Hartenberg parameters, or a program."""
    suffix = without_robot(path)[0].suffix.lower()
    if suffix not in (".csv", ".tsv", ".txt", ".xlsx", ".m", ".py"):
        return False
    try:
        return read_dh(path).moving > 0
    except InputError:
        return False


def read_dh(path: str | Path) -> DhTable:
    """The table of a file; of one that lists several robots, `FILE[ROBOT]`.

    Raises InputError for a missing column, a row that is no joint, and units that nothing shows.
    """
    path, robot = without_robot(path)
    called = called_robot(path)
    table, passed = (
        (called, ())
        if called
        else listed_robot(path, robot)
        or (
            turned_over(framed_table(path, None, len(_LENGTHS_AND_TWIST))[0], _names_lengths)[0],
            (),
        )
    )
    if not table.names:
        raise InputError(
            "the table of the robot has no header",
            code="missing-column",
            place=path.name,
            remedy='name its columns "a", "d", "alpha", "theta", with units: "a [mm]"',
        )
    headings: dict[str, tuple[int, Heading]] = {}
    modified = False
    for i, name in enumerate(table.names):
        header = heading(name)
        word = header.stem.removeprefix(_PREFIX)
        key = _KEYS.get(word) or _MODIFIED.get(word)
        modified |= word in _MODIFIED
        if key is not None and key not in headings:
            headings[key] = (i, header)
    for key in _LENGTHS_AND_TWIST:
        if key not in headings:
            raise InputError(
                f"the table of the robot has no column {key!r}",
                code="missing-column",
                place=path.name,
                remedy='name its columns "a", "d", "alpha", "theta"; theta holds the offsets. '
                "Axes of a product of exponentials go into a mechanism file for --machine: loopcal "
                "new ARM --mechanism exponentials",
            )
    every = np.arange(len(table.rows))
    cells: dict[str, list[_Cell]] = {
        key: [
            _cell(text, table.decimal, f"{path.name}, row {row}, column {headings[key][1].text!r}")
            for row, text in zip(table.rows, table.ids(headings[key][0]), strict=True)
        ]
        for key in ("a", "d", "alpha", "offset")
        if key in headings
    }
    for key in ("alpha", "offset"):
        if key in cells and any(cell.unit for cell in cells[key]):
            column, header = headings[key]
            shared = header.unit or _shared(cells[key])
            headings[key] = (column, replace(header, unit=shared))
            cells[key] = [cell.written_in(shared) for cell in cells[key]]
    numbers: dict[str, Any] = {
        key: np.array([cell.value for cell in cells[key]]) if key in cells else np.zeros(len(every))
        for key in ("a", "d", "alpha", "offset")
    }
    texts = {k: table.ids(headings[k][0]) for k in _TEXTS if k in headings}
    signs = table.numbers(headings["direction"][0], every) if "direction" in headings else None
    units, remarks = _units(numbers, {k: h for k, (_, h) in headings.items()}, path.name)
    forms = [t for t in texts.get("form", ()) if t.strip()]
    if any("mod" in t.lower() or "craig" in t.lower() for t in forms):
        modified = True
    rows = []
    for i in range(len(every)):
        name = texts["name"][i] if "name" in texts else ""
        slides = "d" in cells and cells["d"][i].variable
        word = texts["kind"][i] if "kind" in texts else "prismatic" if slides else ""
        body, parent = (texts[k][i].strip() if k in texts else "" for k in ("body", "parent"))
        if body and is_missing(name):  # a body of a tree that nothing moves
            name, word = "", word or "fixed"
        kind = _kind(word, name, f"{path.name}, row {i + 1}")
        values = {k: float(numbers[k][i] * unit(units[k]).factor) for k in numbers}
        sign = -1 if signs is not None and signs[i] < 0 else 1
        if name.startswith("-") and not is_missing(name):  # a reading that counts backwards
            name, sign = name[1:].strip(), -sign
        rows.append(Row(name, kind=kind, direction=sign, body=body, parent=parent, **values))
    return DhTable(tuple(rows), modified, (*remarks, *passed), modified or bool(forms))


def _names_lengths(names: Sequence[str]) -> bool:
    stems = [heading(name).stem.removeprefix(_PREFIX) for name in names if name]
    keys = {_KEYS.get(stem) or _MODIFIED.get(stem) for stem in stems}
    return keys.issuperset(_LENGTHS_AND_TWIST)


@dataclass(frozen=True)
class _Cell:
    """A number, the unit that its cell shows, and whether it stands beside a joint's variable."""

    value: float
    unit: str = ""
    variable: bool = False

    def written_in(self, name: str) -> _Cell:
        """The same angle in this unit; a cell without a unit is in it already."""
        if not self.unit:
            return self
        return replace(self, value=self.value * unit(self.unit).factor / unit(name).factor)


def _shared(cells: Sequence[_Cell]) -> str:
    """The unit of a column of angles whose header states none, but some of whose cells do.

    Cells without a unit are degrees where others are, or where they exceed a turn in rad.
    """
    plain = [abs(cell.value) for cell in cells if not cell.unit]
    degrees = any(cell.unit == "deg" for cell in cells) or max(plain, default=0.0) > 2.0 * math.pi
    return "deg" if degrees else "rad"


def _cell(text: str, decimal: str, place: str) -> _Cell:
    """A number as tables of robots write it: -90, -90°, -pi/2, or q2 - 90 beside a variable.

    Raises InputError for anything else.
    """
    plain = (
        " ".join(text.split()).replace("−", "-").replace("π", "pi").replace(decimal, ".").lower()
    )
    if is_missing(plain):
        return _Cell(0.0)
    match = _CELL.fullmatch(plain)
    if match is None or not (match["variable"] or match["number"] or match["pi"]):
        raise InputError(
            f"{text!r} is not a number",
            code="invalid-number",
            place=place,
            remedy="write a number, -pi/2, or an offset beside the joint's variable (q2 - 90)",
        )
    sign = -1.0 if match["sign"] == "-" else 1.0
    value = float(match["number"] or (1.0 if match["pi"] else 0.0))
    value *= (math.pi if match["pi"] else 1.0) / float(match["below"] or 1.0)
    stated = "deg" if match["unit"] == "°" else match["unit"] or ""
    shown = "rad" if match["pi"] else stated
    return _Cell(sign * value, shown, bool(match["variable"]))


def _kind(text: str, name: str, place: str) -> str:
    word = text.strip().lower()
    if not word and name.strip().lower() in words("links", "fixed"):
        return "fixed"
    if word not in _KINDS:
        raise InputError(
            f"{text!r} is not a kind of joint",
            code="invalid-value",
            place=place,
            remedy="write revolute, prismatic or fixed",
        )
    return _KINDS[word]


def _units(
    numbers: Mapping[str, Any], headings: Mapping[str, Heading], name: str
) -> tuple[dict[str, str], list[str]]:  # fmt: skip
    """Key -> unit, and what was inferred, in words."""
    units, remarks = {}, []
    lengths = [headings[k].unit for k in ("a", "d") if k in headings and headings[k].unit]
    angles = [headings[k].unit for k in ("alpha", "offset") if k in headings and headings[k].unit]
    reach = float(np.abs(numbers["a"]).sum() + np.abs(numbers["d"]).sum())
    if lengths:
        length = str(lengths[0])
    else:
        length = _length_unit(reach, name)
        size = f"{reach * unit(length).factor:.2g} m"
        remarks.append(f"a and d of {name} are in {length}: so the lengths add up to {size}")
    turns = np.concatenate([numbers["alpha"], numbers["offset"]])
    if angles:
        angle = str(angles[0])
    else:
        large = float(np.abs(turns).max(initial=0.0))
        # No offset exceeds a turn; 0.01 leaves room for a rounded 2 pi (6.29).
        angle = "deg" if large > 2.0 * math.pi + 0.01 else "rad"
        remarks.append(f"alpha and theta of {name} are in {angle}: the largest is {large:g}")
    for key, usual in (("a", length), ("d", length), ("alpha", angle), ("offset", angle)):
        stated_unit = headings[key].unit if key in headings else None
        units[key] = stated_unit or usual
    return units, remarks


def _length_unit(reach: float, name: str) -> str:
    fitting = [u for u in ("m", "mm") if SMALLEST <= reach * unit(u).factor <= LARGEST]
    if not fitting:
        fitting = [u for u in ("cm", "in") if SMALLEST <= reach * unit(u).factor <= LARGEST]
    if len(fitting) == 1:
        return fitting[0]
    sizes = ", ".join(f"{reach * unit(u).factor:.3g} m if in {u}" for u in fitting or ("m", "mm"))
    raise InputError(
        f"the unit of a and d is not stated, and their size does not show it ({sizes})",
        code="unknown-unit",
        place=name,
        remedy='state it in the header: "a [mm]", "d [mm]"',
    )


def chain_rows(table: DhTable) -> tuple[dict[str, float], tuple[Row, ...]]:
    """Fixed motions ahead of the first joint, and the rows of classical form of the joints.

    Rx(alpha) and Tx(a) of the modified convention stand behind the joint before, as in the
    classical one; rows that do not move become fixed motions, which the writer of the project
    appends.
    """
    rows = list(table.rows)
    if not table.modified:
        return {}, tuple(rows)
    # Craig: T = Rx(alpha) Tx(a) Rz(theta) Tz(d); classical: Rz(theta) Tz(d) Tx(a) Rx(alpha).
    first = {"rx": rows[0].alpha, "tx": rows[0].a}
    moved = [*rows[1:], Row("", 0.0, 0.0, 0.0, 0.0)]
    return first, tuple(
        Row(r.name, n.a, r.d, n.alpha, r.offset, r.kind, r.direction)
        for r, n in zip(rows, moved, strict=True)
    )


def joint_names(rows: Sequence[Row], columns: Sequence[str]) -> tuple[str, ...]:
    """Names of the moving joints: of the rows, of their columns, else theta_1, theta_2, ..."""
    moving = [row for row in rows if row.kind != "fixed"]
    for names in ([row.name for row in moving], list(columns)):
        plain = all(name.isidentifier() for name in names)
        if plain and len(set(names)) == len(moving) == len(names):
            return tuple(names)
    return tuple(f"theta_{i}" for i in range(1, len(moving) + 1))
