"""Observations of a tree of bodies as they are typed: "contact between=EE1,EE2 radius=58mm,58mm".

The first word is the type of an instrument; each other one is a key of its table and its value,
of several values divided by commas. Four keys say where the readings stand: `columns`, the columns
in the order of the instrument's readings; `joints`, JOINT:COLUMN where a file names joints
otherwise; `file`, part of the name of the one file that holds it; and `where`, COLUMN:VALUE of the
rows in which it was observed. Pixels stand in a table of corners: `camera` and `board`
choose its rows, by default all. Of a single point with columns beside the joints `columns` names u
and v, and `camera` names the camera.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from loopcal.errors import UsageError

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
