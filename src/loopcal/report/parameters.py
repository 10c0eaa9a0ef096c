"""The parameters grouped by owner, each with its meaning and its change drawn beside its sd."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.report.source import Source
from loopcal.report.tables import parameter_cells, parameter_head
from loopcal.report.templates import CELL

REST = "machine"
"""Group of the parameters without an owner."""
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

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells, with the room of the bar."""
        return [(*line.cells, " " * CELL) for group in self.groups for line in group.lines]


def parameter_groups(source: Source) -> ParameterGroups:
    """The parameters of a result, without the many of its model error."""
    document = source.document
    shown = shown_parameters(document.parameters, document.terms)
    reach = _reach(shown)
    grouped: dict[str, list[Line]] = {}
    for entry in shown:
        line = _line(entry, reach.get(entry.unit, 0.0), document)
        grouped.setdefault(entry.owner or REST, []).append(line)
    groups = tuple(Group(name, tuple(lines)) for name, lines in grouped.items())
    return ParameterGroups((*parameter_head(document), "change, 2 sd"), groups)


def _reach(entries: Iterable[ParameterEntry]) -> dict[str, float]:
    """The scale of each unit: the widest change with its sd, unless most are far smaller."""
    changes_by_unit: dict[str, list[float]] = {}
    for p in entries:
        if not p.fixed:
            far = abs(p.value - p.nominal) + 2.0 * (p.sd or 0.0)
            changes_by_unit.setdefault(p.unit, []).append(far)
    return {unit: min(max(all_), WIDEST * median(all_)) for unit, all_ in changes_by_unit.items()}


def _line(entry: ParameterEntry, reach: float, document: ResultDocument) -> Line:
    cells = parameter_cells(entry, document)
    if entry.fixed or not reach:
        return Line(cells, entry.meaning)
    change, sd = 50.0 * (entry.value - entry.nominal) / reach, 50.0 * (entry.sd or 0.0) / reach
    low, middle, high = (min(max(50.0 + change + k * sd, 0.0), 100.0) for k in (-2.0, 0.0, 2.0))
    left, width = min(50.0, middle), abs(middle - 50.0)
    return Line(cells, entry.meaning, left, width, low, high, abs(change) > 50.0)
