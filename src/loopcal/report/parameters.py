"""The parameters grouped by joint, each with what it means and its change drawn beside its sd."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.skeleton import target_names
from loopcal.mechanisms.structure.sag import GRAVITY
from loopcal.report.source import Source
from loopcal.report.tables import parameter_cells, parameter_head

MOTIONS = {"t": "shift along", "r": "turn about"}
_CHANGED = re.compile(r"^(?P<of>.+)_(?P<how>from(?P<pose>\d+)|drift)$")
_PLACED = re.compile(r"^(?P<what>.+)_(?P<axis>[xyz]|r[xyz])$")
REST, TARGET = "machine", "target"
WIDEST = 5.0
"""The scale of the bars is at most so many times the median change of its unit."""


@dataclass(frozen=True)
class Line:
    """One parameter: cells of its row; meaning: what it is; bar: its change and sd, drawn.

    left, width: of the bar of the change; low, high: ends of the interval of two sds; all in
    percent of a scale for each unit, 50 where nothing changed; beyond: whether it is longer.
    """

    cells: tuple[str, ...]
    meaning: str
    left: float = 50.0
    width: float = 0.0
    low: float = 50.0
    high: float = 50.0
    beyond: bool = False


@dataclass(frozen=True)
class Group:
    """The parameters of one part of the machine."""

    name: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class ParameterGroups:
    """head: names of the columns; groups: in the order of the machine."""

    head: tuple[str, ...]
    groups: tuple[Group, ...]


def parameter_groups(source: Source) -> ParameterGroups:
    """The parameters of a result, without the many of its model error."""
    document = source.document
    shown = shown_parameters(document.parameters, document.terms)
    reach = _reach(shown)
    places = _places(source.mechanism)
    grouped: dict[str, list[Line]] = {}
    for entry in shown:
        place, meaning = _place(entry.name, places, document)
        line = _line(entry, meaning, reach.get(entry.unit, 0.0), document)
        grouped.setdefault(place, []).append(line)
    groups = tuple(Group(name, tuple(lines)) for name, lines in grouped.items())
    return ParameterGroups((*parameter_head(document), "change, 2 sd"), groups)


def _reach(entries: Iterable[ParameterEntry]) -> dict[str, float]:
    """The scale of each unit: the widest change with its sd, unless most are far smaller."""
    found: dict[str, list[float]] = {}
    for p in entries:
        if not p.fixed:
            far = abs(p.value - p.nominal) + 2.0 * (p.sd or 0.0)
            found.setdefault(p.unit, []).append(far)
    return {unit: min(max(all_), WIDEST * median(all_)) for unit, all_ in found.items()}


def _line(entry: ParameterEntry, meaning: str, reach: float, document: ResultDocument) -> Line:
    cells = parameter_cells(entry, document)
    if entry.fixed or not reach:
        return Line(cells, meaning)
    change, sd = 50.0 * (entry.value - entry.nominal) / reach, 50.0 * (entry.sd or 0.0) / reach
    low, middle, high = (_within(50.0 + v) for v in (change - 2.0 * sd, change, change + 2.0 * sd))
    left, width = min(50.0, middle), abs(middle - 50.0)
    return Line(cells, meaning, left, width, low, high, abs(change) > 50.0)


def _within(value: float) -> float:
    return min(max(value, 0.0), 100.0)


def _places(mechanism: Mechanism | None) -> dict[str, tuple[str, str]]:
    """Parameters of a chain: the joint they follow, and what they mean."""
    found: dict[str, tuple[str, str]] = {}
    place = "base"
    for step in () if mechanism is None else mechanism.chain:
        place = step.joint or place
        if step.parameter is None:
            continue
        if step.joint is not None:
            meaning = f"zero of {step.joint}: added to its reading"
        else:
            after = "before the first joint" if place == "base" else f"after {place}"
            meaning = f"{MOTIONS[step.motion[0]]} the {step.motion[1]} axis {after}"
        found[step.parameter] = (place, meaning)
    point = () if mechanism is None else target_names(mechanism)
    return found | {name: (TARGET, f"measured point on the last link: {name}") for name in point}


def _place(
    name: str, places: dict[str, tuple[str, str]], document: ResultDocument
) -> tuple[str, str]:
    """The group of a parameter and its meaning, "" where only its author knows it."""
    if name in places:
        return places[name]
    if changed := _CHANGED.match(name):
        of = changed["of"]
        inside, _ = _place(of, places, document)
        how = f"from pose {changed['pose']} on" if changed["pose"] else "along the run"
        return inside, f"change of {of} {how}"
    joints = {} if document.mechanism is None else document.mechanism.quantities
    owner = next((q for q in joints if name.startswith(f"{q}_")), None)
    if owner is not None:
        return owner, f"of {owner}"
    if placed := _PLACED.match(name):
        motion = "turn about" if placed["axis"].startswith("r") else "position along"
        meaning = f"{motion} {placed['axis'][-1]}: place of {placed['what']}"
        return placed["what"], meaning
    return REST, "tilt of gravity against the base" if name.startswith(f"{GRAVITY}_tilt_") else ""
