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
from loopcal.files.recognition.headers import Heading, heading
from loopcal.files.tables.cells import is_missing
from loopcal.files.tables.readers import read_table
from loopcal.units import unit

_KEYS = {
    **dict.fromkeys(("a", "r", "a_i", "ai", "length", "link_length"), "a"),
    **dict.fromkeys(("d", "d_i", "di", "offset_d", "link_offset"), "d"),
    **dict.fromkeys(("alpha", "alpha_i", "alphai", "twist", "al"), "alpha"),
    **dict.fromkeys(
        ("theta", "offset", "theta_offset", "theta0", "theta_0", "theta_i", "th"), "offset"
    ),
    **dict.fromkeys(("joint", "name", "axis", "i", "link", "id", "no", "nr"), "name"),
    **dict.fromkeys(("type", "kind", "joint_type"), "kind"),
    **dict.fromkeys(("direction", "sign", "dir"), "direction"),
    **dict.fromkeys(("convention", "form"), "form"),
}
_CELL = re.compile(
    r"(?P<variable>(?!pi)[a-zθϑ][a-zθϑ_]*_?\d*\*?)?\s*(?P<sign>[-+])?\s*"
    r"(?P<number>\d+\.?\d*(?:e[-+]?\d+)?|\.\d+)?\s*\*?\s*"
    r"(?P<pi>pi)?(?:\s*/\s*(?P<below>[1-9]\d*))?\s*(?P<degrees>°)?"
)
_MODIFIED = {"a_i_1": "a", "ai_1": "a", "a_prev": "a", "alpha_i_1": "alpha", "alphai_1": "alpha"}
_KINDS = {
    **dict.fromkeys(("", "r", "rev", "revolute", "rotary", "continuous"), "revolute"),
    **dict.fromkeys(("p", "prism", "prismatic", "linear"), "prismatic"),
    **dict.fromkeys(("f", "fix", "fixed"), "fixed"),
}
_FIXED_NAMES = ("tool", "tcp", "flange", "reflector", "target", "base", "world", "turntable", "ee")
SMALLEST, LARGEST = 0.1, 10.0
"""Sums of all lengths of a machine that are plausible [m]."""


@dataclass(frozen=True)
class Row:
    """One row: lengths [m], angles [rad]; kind: "revolute", "prismatic" or "fixed"."""

    name: str
    a: float
    d: float
    alpha: float
    offset: float
    kind: str = "revolute"
    direction: int = 1


@dataclass(frozen=True)
class DhTable:
    """A machine by its rows; modified: of the convention of Craig; remarks: what was inferred."""

    rows: tuple[Row, ...]
    modified: bool
    remarks: tuple[str, ...]

    @property
    def moving(self) -> int:
        """How many joints move."""
        return sum(row.kind != "fixed" for row in self.rows)


def read_dh(path: str | Path) -> DhTable:
    """The table of a file.

    Raises InputError for a missing column, a row that is no joint, and units that nothing shows.
    """
    path = Path(path)
    table = read_table(path)
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
        its = heading(name)
        key = _KEYS.get(its.stem) or _MODIFIED.get(its.stem)
        modified |= its.stem in _MODIFIED
        if key is not None and key not in headings:
            headings[key] = (i, its)
    for key in ("a", "d", "alpha"):
        if key not in headings:
            raise InputError(
                f"the table of the robot has no column {key!r}",
                code="missing-column",
                place=path.name,
                remedy='name its columns "a", "d", "alpha", "theta"; theta holds the offsets',
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
            column, its = headings[key]
            shared = its.unit or _shared(cells[key])
            headings[key] = (column, replace(its, unit=shared))
            cells[key] = [cell.written_in(shared) for cell in cells[key]]
    numbers: dict[str, Any] = {
        key: np.array([cell.value for cell in cells[key]]) if key in cells else np.zeros(len(every))
        for key in ("a", "d", "alpha", "offset")
    }
    texts = {k: table.ids(headings[k][0]) for k in ("name", "kind", "form") if k in headings}
    signs = table.numbers(headings["direction"][0], every) if "direction" in headings else None
    units, told = _units(numbers, {k: h for k, (_, h) in headings.items()}, path.name)
    if any("mod" in t.lower() or "craig" in t.lower() for t in texts.get("form", ())):
        modified = True
    rows = []
    for i in range(len(every)):
        name = texts["name"][i] if "name" in texts else ""
        slides = "d" in cells and cells["d"][i].variable
        word = texts["kind"][i] if "kind" in texts else "prismatic" if slides else ""
        kind = _kind(word, name, f"{path.name}, row {i + 1}")
        values = {k: float(numbers[k][i] * unit(units[k]).factor) for k in numbers}
        sign = -1 if signs is not None and signs[i] < 0 else 1
        rows.append(Row(name, kind=kind, direction=sign, **values))
    return DhTable(tuple(rows), modified, tuple(told))


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
    plain = text.strip().replace("−", "-").replace("π", "pi").replace(decimal, ".").lower()
    if is_missing(plain):
        return _Cell(0.0)
    found = _CELL.fullmatch(plain)
    if found is None or not (found["variable"] or found["number"] or found["pi"]):
        raise InputError(
            f"{text!r} is not a number",
            code="invalid-number",
            place=place,
            remedy="write a number, -pi/2, or an offset beside the joint's variable (q2 - 90)",
        )
    sign = -1.0 if found["sign"] == "-" else 1.0
    value = float(found["number"] or (1.0 if found["pi"] else 0.0))
    value *= (math.pi if found["pi"] else 1.0) / float(found["below"] or 1.0)
    shown = "rad" if found["pi"] else "deg" if found["degrees"] else ""
    return _Cell(sign * value, shown, bool(found["variable"]))


def _kind(text: str, name: str, place: str) -> str:
    word = text.strip().lower()
    if not word and name.strip().lower() in _FIXED_NAMES:
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
    units, told = {}, []
    lengths = [headings[k].unit for k in ("a", "d") if k in headings and headings[k].unit]
    angles = [headings[k].unit for k in ("alpha", "offset") if k in headings and headings[k].unit]
    reach = float(np.abs(numbers["a"]).sum() + np.abs(numbers["d"]).sum())
    if lengths:
        length = str(lengths[0])
    else:
        length = _length_unit(reach, name)
        size = f"{reach * unit(length).factor:.2g} m"
        told.append(f"a and d of {name} are in {length}: so the lengths add up to {size}")
    turns = np.concatenate([numbers["alpha"], numbers["offset"]])
    if angles:
        angle = str(angles[0])
    else:
        large = float(np.abs(turns).max(initial=0.0))
        angle = "deg" if large > 2.0 * math.pi + 0.01 else "rad"
        told.append(f"alpha and theta of {name} are in {angle}: the largest is {large:g}")
    for key, usual in (("a", length), ("d", length), ("alpha", angle), ("offset", angle)):
        its = headings[key].unit if key in headings else None
        units[key] = its or usual
    return units, told


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
