"""Rows of files in which parts of a whole robot were observed, one file below the other.

A file holds the joints between two bodies, and what was observed between them; what it does not
hold was not read there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, UsageError, listed
from loopcal.files.recognition.fields import Field, Source, in_si, taken_in
from loopcal.files.recognition.joint_sets import named_joints
from loopcal.files.tables.readers import read_table
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Family, Mechanism

# Observations of a tree of bodies as they are typed: "contact between=EE1,EE2 radius=58mm,58mm".
#
# The first word is the type of an instrument; each other one is a key of its table and its value,
# of several values divided by commas. Four keys say where the readings stand: `columns`, the
# columns in the order of the instrument's readings; `joints`, JOINT:COLUMN where a file names
# joints otherwise; `file`, part of the name of the one file that holds it; and `where`,
# COLUMN:VALUE of the rows in which it was observed. Pixels stand in a table of corners: `camera`
# and `board` choose its rows, by default all. Of a single point with columns beside the joints
# `columns` names u and v, and `camera` names the camera.


_AMOUNT = re.compile(r"(?P<number>[-+]?\d+\.?\d*(?:e[-+]?\d+)?)(?P<unit>[a-zµ°%]+)?", re.I)
_APART = ("columns", "joints", "file", "where")
_CORNERS = ("camera", "board")
_LISTS = ("between", "radius", "readings", "normal", "gravity", "gaps", "columns")


@dataclass(frozen=True)
class Observation:
    """table: of [[mechanism.instrument]]; columns: of its readings, empty where their names say;
    joints: joint -> its column in this file; file, where: in which rows it was observed; camera,
    board: of the corners, empty for all; text: as it was typed."""

    table: Mapping[str, Any]
    columns: tuple[str, ...] = ()
    joints: Mapping[str, str] | None = None
    file: str = ""
    where: tuple[str, str] | None = None
    camera: str = ""
    board: str = ""
    text: str = ""

    @property
    def name(self) -> str:
        """Of the instrument."""
        return str(self.table["name"])

    def of_file(self, path: Path | None) -> bool:
        """Whether a file may hold it."""
        return not self.file or (path is not None and fnmatchcase(path.name, f"*{self.file}*"))


def observation(text: str) -> Observation:
    """One observation as it is typed.

    Raises UsageError for what is no key and value.
    """
    kind, *pairs = text.split()
    keys: dict[str, str] = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not value or key in keys:
            raise UsageError(
                f"{pair!r} of the observation {text!r} is no key and value",
                remedy="write a type and keys, as 'point on=hand station=tracker columns=x,y,z'",
            )
        keys[key] = value
    apart = _APART + (_CORNERS if kind == "camera" else ())
    table: dict[str, Any] = {"type": kind, "name": keys.pop("name", kind.replace("-", "_"))}
    table |= {k: _value(k, v) for k, v in keys.items() if k not in apart}
    if kind == "camera" and table.get("on") == "base":
        del table["on"]  # where it is by default
    joints = dict(_pair(text, part) for part in keys.get("joints", "").split(",") if part)
    return Observation(
        table,
        tuple(filter(None, keys.get("columns", "").split(","))),
        joints or None,
        keys.get("file", ""),
        _pair(text, keys["where"]) if "where" in keys else None,
        camera=keys.get("camera", "") if kind == "camera" else "",
        board=keys.get("board", "") if kind == "camera" else "",
        text=text,
    )


def observations(texts: Sequence[str]) -> list[Observation]:
    """All that are typed. Raises UsageError for two of one name, too."""
    made = [observation(text) for text in texts]
    names = [one.name for one in made]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(
            f"two observations are named {twice[0]!r}",
            remedy="give each a name, as 'point name=left_tracker on=left_hand'",
        )
    return made


def seen_as(name: str, typed: Sequence[Observation]) -> Observation | None:
    """What was typed of an instrument: of a camera that sees several boards NAME_BOARD is one."""
    some = [one for one in typed if f"{name}_".startswith(f"{one.name}_")]
    return max(some, key=lambda one: len(one.name), default=None)


def _pair(text: str, part: str) -> tuple[str, str]:
    before, sign, after = part.partition(":")
    if not sign:
        raise UsageError(
            f"{part!r} of the observation {text!r} has no ':'",
            remedy="write joints=S1:S,L1:L and where=set:upper",
        )
    return before, after


def _value(key: str, text: str) -> Any:
    parts = [_amount(part) for part in text.split(",")]
    return parts if len(parts) > 1 or key in _LISTS else parts[0]


def _amount(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    match = _AMOUNT.fullmatch(text)
    if match is None:
        return text
    number = float(match["number"])
    return {"value": number, "unit": match["unit"]} if match["unit"] else number


@dataclass(eq=False)
class Rows:
    """The poses of all files, one below the other: ids, and columns by quantity."""

    poses: list[str] = field(default_factory=list)
    columns: dict[str, list[Array]] = field(default_factory=dict)
    count: int = 0

    def add(self, ids: Sequence[str], columns: Mapping[str, Array]) -> None:
        """The poses of one file; what it does not have is blank."""
        for name in {**self.columns, **columns}:
            ahead = self.columns.setdefault(name, [np.full(self.count, np.nan)])
            ahead.append(columns.get(name, np.full(len(ids), np.nan)))
        self.poses += ids
        self.count += len(ids)

    def values(self, name: str) -> Array:
        """A column (N,), blank where no file has it."""
        return np.concatenate(self.columns.get(name, [np.full(self.count, np.nan)]))


Pixels = Mapping[int, Mapping[str, Array]]
"""By the identity of a source, readings of cameras in its rows."""


def with_readings(one: Observation) -> dict[str, Any]:
    """The table of an instrument whose readings are named after it: several may be of one kind."""
    table = dict(one.table)
    if table["type"] == "camera":
        # Until the files say which boards and points there are.
        table["board"], table["points"] = f"{one.name}_board", {"0": [0.0, 0.0, 0.0]}
    if table["type"] not in ("camera", "contact", "held-part", "inclinometer", "seen-plane"):
        table.setdefault("target", f"{one.name}_target")
    # A station or target of the same name has the parameters NAME_x, ...
    alike = one.columns and one.name in (table.get("station"), table.get("target"))
    if table["type"] in ("point", "pose") and "readings" not in table:
        seen = f"{one.name}_seen" if alike else one.name
        table["readings"] = [f"{seen}_{axis}" for axis in "xyz"]
    if table["type"] == "pose" and "columns" not in table:
        table["columns"] = [f"{one.name}_{part}" for part in ("qw", "qx", "qy", "qz")]
    return table


def rows_of(
    sources: Sequence[Source],
    mechanism: Mechanism,
    looking: Sequence[Observation],
    pixels: Pixels,
    *,
    later: bool = False,
) -> tuple[Rows, tuple[str, ...]]:
    """The poses of all files, and what was read in which, in words.

    pixels: by the identity of a source, those of its rows; later: the files are of another day,
    and may have other names.
    """
    rows, words = Rows(), list[str]()
    families = {family.name: family for family in mechanism.families}
    units = mechanism.units
    several = len(sources) > 1
    for source in sources:
        mine = [one for one in looking if one.of_file(source.path)]
        if later and not any(one.table["type"] != "camera" for one in mine):
            mine += _by_layout(source, looking, mechanism)
        joints = joints_in(source, mechanism, mine)
        read: dict[str, Field] = {}
        seen: dict[str, Array] = {}
        for one in mine:
            family = families[one.name]
            if one.table["type"] == "camera":
                corners = pixels.get(id(source), {})
                seen |= {q: corners[q] for q in family.readings if q in corners}
            elif reach(mechanism, family) <= joints.keys():
                columns = _columns(source, one, family, mechanism)
                if columns is not None:
                    read |= columns
                    seen |= _seen(columns, chosen_rows(source, one), family, mechanism)
        if not seen:
            in_names = dict.fromkeys(one.file for one in looking if one.file)
            if later and in_names and not mine:
                raise InputError(
                    "nothing says which observations stand in this file",
                    code="missing-column",
                    place=source.name,
                    remedy="name it as on the first day: its name then held "
                    + " or ".join(map(repr, in_names)),
                )
            raise InputError(
                "no observation stands in this file",
                code="missing-column",
                place=source.name,
                remedy="name it: --observe 'point on=BODY columns=x,y,z', or leave the file out; "
                f"its joints are {listed(list(joints), 30)}"
                if joints
                else "its columns are named "
                f"as no joint of the robot: joints are {listed(list(mechanism.joints), 30)}",
            )
        by_joint = in_si(joints, mechanism.joints)
        any_seen = np.any([np.isfinite(v) for v in seen.values()], axis=0)
        ids = source.ids or tuple(str(i) for i in range(1, len(source) + 1))
        stem = source.path.stem if source.path else source.name
        kept = np.flatnonzero(any_seen)
        rows.add(
            [f"{stem}:{ids[i]}" if several else ids[i] for i in kept],
            {name: v[kept] for name, v in {**by_joint, **seen}.items()},
        )
        met = [o.name for o in looking if any(q in seen for q in families[o.name].readings)]
        words.append(f"{source.name}: {len(kept)} poses with {listed(met, 8)}")
        for what, some in (("joints", joints), ("readings", read)):
            unstated = {q: f for q, f in some.items() if f.unit is None and units[q] != "1"}
            if unstated:
                taken = " and ".join(taken_in(unstated, units).values())
                words.append(f"{source.name}: {what} without a unit are taken in {taken}")
    return rows, tuple(words)


def _by_layout(
    source: Source, looking: Sequence[Observation], mechanism: Mechanism
) -> list[Observation]:
    """What was observed in the one file of the first day that had this one's joints and columns."""
    families = {family.name: family for family in mechanism.families}
    labels = {label for field in source.fields for label in (field.label.lower(), field.stem)}
    fitting = []
    for word in dict.fromkeys(one.file for one in looking if one.file):
        some = [one for one in looking if one.file == word]
        joints = joints_in(source, mechanism, some).keys()
        if all(
            reach(mechanism, families[one.name]) <= joints
            and labels.issuperset(c.lower() for c in (*one.columns, *(one.joints or {}).values()))
            for one in some
        ):
            fitting.append(some)
    return fitting[0] if len(fitting) == 1 else []


def reach(mechanism: Mechanism, family: Family) -> set[str]:
    """The joints between the two bodies of an observation."""
    assert mechanism.tree is not None
    path = mechanism.tree.path(family.on, family.against)
    return {step.joint for step in path if step.joint}


def joints_in(
    source: Source, mechanism: Mechanism, looking: Sequence[Observation]
) -> dict[str, Field]:
    """The joints that a file has columns for: those stated, and others by their names.

    Beside stated ones a name counts as it is written: r2 is not the joint R2.
    """
    stated: dict[str, Field] = {}
    for one in looking:
        columns = one.joints or {}
        by_column = named_joints(source.fields, columns.values())
        stated |= {
            joint: by_column[column]
            for joint, column in columns.items()
            if column in by_column and joint in mechanism.joints
        }
    named = named_joints(source.fields, mechanism.joints)
    if stated:
        named = {
            j: f for j, f in named.items() if f.label.startswith(j) and f not in stated.values()
        }
    return named | stated


def _columns(
    source: Source, one: Observation, family: Family, mechanism: Mechanism
) -> dict[str, Field] | None:
    """The columns of what an observation reads; None where the file does not have them."""
    constants = [c for c in mechanism.pose_constants if c.startswith(f"{one.name}_")]
    silent = [q for q in family.readings if q in mechanism.implied]
    spoken = [q for q in (*family.readings, *constants) if q not in silent]
    names = one.columns or tuple(spoken)
    if len(names) != len(spoken):
        raise InputError(
            f"{one.name!r} reads {len(spoken)} values, but {len(names)} columns are named",
            code="wrong-shape",
            place="--observe",
            remedy=f"name them in this order: {listed(spoken, 12)}",
        )
    fields = named_joints(source.fields, names)
    if absent := [name for name in names if name not in fields]:
        if one.columns and one.file:
            raise InputError(
                f"{source.name} has no column {absent[0]!r}",
                code="missing-column",
                place="--observe",
                remedy=f"its columns are {listed([f.label for f in source.fields], 30)}",
            )
        return None
    return {q: fields[name] for q, name in zip(spoken, names, strict=True)}


def _seen(
    columns: Mapping[str, Field], chosen: Any, family: Family, mechanism: Mechanism
) -> dict[str, Array]:
    """The readings of an observation in the chosen rows of a file, gaps of what touches as 0."""
    units = mechanism.units
    silent = [q for q in family.readings if q in mechanism.implied]
    seen = {q: np.where(chosen, v, np.nan) for q, v in in_si(columns, units).items()}
    complete = np.all([np.isfinite(v) for v in seen.values()], axis=0) if seen else chosen
    return seen | {q: np.where(complete, 0.0, np.nan) for q in silent}


def chosen_rows(source: Source, one: Observation) -> Any:
    """The rows in which an observation was made."""
    if one.where is None:
        return np.ones(len(source), dtype=bool)
    label, value = one.where
    column = next((f for f in source.fields if label in (f.label, f.stem)), None)
    cells: Sequence[str]
    if column is not None:
        cells = [column.words(float(v)) for v in column.values]
    else:
        cells = _texts(source, label)
    return np.array([fnmatchcase(cell, value) for cell in cells])


def _texts(source: Source, label: str) -> Sequence[str]:
    """The cells of a column of words."""
    table = None if source.path is None else read_table(source.path)
    if table is None or label not in table.names or len(table.rows) != len(source):
        names = [f.label for f in source.fields] if table is None else list(table.names)
        raise InputError(
            f"{source.name} has no column {label!r} with a cell in each row",
            code="missing-column",
            place="--observe",
            remedy=f"its columns are {listed(names, 30)}",
        )
    return table.ids(table.names.index(label))


def later_rows(
    sources: Sequence[Source],
    mechanism: Mechanism,
    observe: Sequence[Observation],
    pixels: Pixels,
) -> Dataset:
    """Readings of another day: files in the layout of the first ones, perhaps of one arm alone.

    observe: what was observed, as typed at `init`, cameras as the mechanism has them. What a file
    does not hold was not read there. Raises InputError where nothing stands in a file.
    """
    looking = [replace(one, table=with_readings(one)) for one in observe]
    rows, _ = rows_of(sources, mechanism, looking, pixels, later=True)
    units = mechanism.units
    seen = [q for one in mechanism.families for q in one.readings]
    names = dict.fromkeys((*mechanism.joints, *seen, *rows.columns))
    readings = {q: rows.values(q) for q in names}
    return Dataset.from_arrays(readings, units={q: units[q] for q in names}, poses=rows.poses)
