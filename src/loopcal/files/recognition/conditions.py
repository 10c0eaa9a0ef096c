"""Columns of what was not measured of the machine: its load, its tool, the temperature."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from loopcal.files.recognition.fields import TOOLS, Field, names_of
from loopcal.files.recognition.headers import words
from loopcal.files.recognition.joins import Fields
from loopcal.presentation.shown import significant

_PAYLOADS = frozenset(words("columns", "payload"))
_TEMPERATURES = frozenset(words("columns", "temperature"))
# Chosen, not derived: the strongest arms carry some 2 t; rooms and yards are as warm as this.
_HEAVIEST = 2500.0
_DEGREES = {"degC": (-40.0, 60.0), "K": (233.0, 333.0)}


@dataclass(frozen=True)
class Conditions:
    """columns: known constant -> its column and that column's unit; table: what the mechanism says
    of them; remarks: what is made of each column of a condition, for the reader."""

    columns: Mapping[str, tuple[Field, str]] = field(default_factory=dict)
    table: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def apart(fields: Fields, joints: Collection[str], *, arm: bool) -> tuple[Fields, Conditions]:
    """The columns without those of conditions, and these.

    joints: names of the machine's; arm: whether it gives way under what it carries.
    """
    payloads, temperatures, tools = by_condition(fields, joints).values()
    parts = [
        *(_payload(one, arm) for one in payloads[:1]),
        *(_temperature(one) for one in temperatures[:1]),
        *(_tool(one) for one in tools[:1]),
    ]
    others = [*payloads[1:], *temperatures[1:], *tools[1:]]
    if others:
        words = f"Further columns of conditions take no part: {names_of(others)}."
        parts.append(Conditions(remarks=(words,)))
    gone = {id(f) for f in (*payloads, *temperatures, *tools)}
    kept = tuple(f for f in fields.fields if id(f) not in gone)
    return replace(fields, fields=kept), Conditions(
        {name: column for part in parts for name, column in part.columns.items()},
        {key: value for part in parts for key, value in part.table.items()},
        tuple(words for part in parts for words in part.remarks),
    )


def by_condition(fields: Fields, joints: Collection[str]) -> dict[str, list[Field]]:
    """The columns of a "payload", a "temperature" and a "tool", the likeliest first.

    joints: names of the machine's, which are none of these.
    """
    free = [f for f in fields.fields if f.heading and f.heading.text not in joints]
    return {
        "payload": _named(free, ("kg",), _PAYLOADS),
        "temperature": _named(free, tuple(_DEGREES), _TEMPERATURES),
        "tool": _named(free, (), TOOLS),
    }


def degrees_of(column: Field) -> str | None:
    """The unit of a column of temperatures; None where no workshop is as cold or as warm."""
    low, high = float(np.min(column.values)), float(np.max(column.values))
    fitting = [u for u, (least, most) in _DEGREES.items() if least <= low and high <= most]
    degrees = column.unit or next(iter(fitting), None)
    return degrees if degrees in fitting else None


def _named(free: Sequence[Field], units: Collection[str], names: Collection[str]) -> list[Field]:
    """Columns in one of these units, then those without a unit that have such a name."""
    stated = [f for f in free if f.unit in units]
    # A share of the largest load, as of a motor, is no mass.
    return stated + [f for f in free if f.unit is None and f.stem in names and "%" not in f.label]


def _payload(column: Field, arm: bool) -> Conditions:
    low, high = float(np.min(column.values)), float(np.max(column.values))
    shown = f"Column {column.label!r}"
    if not (arm and low >= 0.0 and high <= _HEAVIEST):
        why = (
            f"a payload is 0 to {_HEAVIEST:g} kg in every row" if arm else "this machine is no arm"
        )
        return Conditions(remarks=(f"{shown} takes no part: {why}.",))
    if low == high:
        words = f"{shown} is {low:g} kg in every row: the calibration holds for this load alone."
        return Conditions(remarks=(words,))
    words = (
        f"{shown} is the payload, {low:g} to {high:g} kg: in each pose the joints yield to its "
        "weight at the target."
    )
    return Conditions({"payload": (column, "kg")}, {"payload": "payload"}, (words,))


def _temperature(column: Field) -> Conditions:
    low, high = float(np.min(column.values)), float(np.max(column.values))
    degrees = degrees_of(column)
    shown = f"Column {column.label!r}"
    if degrees is None:
        words = f"{shown} takes no part: a temperature is -40 to 60 degC in every row, or so in K."
        return Conditions(remarks=(words,))
    if low == high:
        return Conditions(remarks=(f"{shown} is {low:g} {degrees} in every row: no part.",))
    mean = float(significant(float(column.values.mean()), 3))
    words = (
        f"{shown} is the temperature, {low:g} to {high:g} {degrees}: all lengths of the machine "
        f"expand with what it differs from {mean:g} {degrees}, by one coefficient."
    )
    effect = {"type": "thermal", "column": "temperature", "reference": mean, "unit": degrees}
    return Conditions({"temperature": (column, degrees)}, {"effect": [effect]}, (words,))


def _tool(column: Field) -> Conditions:
    kinds = len(np.unique(column.values))
    words = f"Column {column.label!r} names one tool and takes no part."
    if kinds > 1:
        words = (
            f"Column {column.label!r} names {kinds} tools and takes no part. Where each carries "
            "the target elsewhere, begin with the rows of one tool. Or give each tool an "
            "instrument with a target, whose columns are blank in the rows of other tools."
        )
    return Conditions(remarks=(words,))
