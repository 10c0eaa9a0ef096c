"""The page: sources in, one self-contained HTML text out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from loopcal.companions import called
from loopcal.document.fit import ParameterEntry
from loopcal.document.plain import plain
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import shown_parameters
from loopcal.document.verdict import UNJUDGED
from loopcal.errors import InputError, UsageError
from loopcal.estimation.methods.registry import method_named
from loopcal.estimation.result import FitResult
from loopcal.files.atomic import write_atomic
from loopcal.report import tables, top
from loopcal.report.drawn import distances, figures
from loopcal.report.images import OF_IMAGES, image_table
from loopcal.report.source import Source, read_source, source_of
from loopcal.report.tables import parameter_cells, parameter_head
from loopcal.report.templates import CELL, Section, page

SectionsOf = Callable[[Source], Iterable[Section]]
"""What a report says of a result beyond the calibration."""
MOST = 8
"""So many results stand side by side; a browser draws some sixteen scenes in space at most."""
QUESTIONS = {
    "sound": "Sound?",
    "valid": "Valid where?",
    "better": "Better than what you had?",
    "tolerance": "Good enough?",
}
_KINDS = {"lens": "camera", "print": "board"}
"""By the role of a parameter what its owner is."""
LITTLE = 0.5
"""Sd over prior sd above which it is said that the data tell little."""


def report_html(sources: Sequence[Source], sections: SectionsOf = lambda _: ()) -> str:
    """The report of one result, or of several side by side.

    sections: what it says beyond the calibrations. Everything is inside: styles, program and data;
    nothing is asked of any network. Raises UsageError for more results than a page can hold.
    """
    if not 1 <= len(sources) <= MOST:
        raise UsageError(
            f"{len(sources)} results for one report", remedy=f"give from 1 to {MOST} of them"
        )
    several = len(sources) > 1
    if len({source.name for source in sources}) < len(sources):
        # Folders of one name: a number distinguishes them.
        sources = [
            replace(source, name=f"{n}: {source.name}") for n, source in enumerate(sources, 1)
        ]
    results = [_result(source, sections(source), n) for n, source in enumerate(sources, 1)]
    return page(
        "report.html",
        title=", ".join(dict.fromkeys(source.title for source in sources)),
        results=results,
        sections={key: one.title for r in results for key, one in r["sections"].items()},
        comparison=tables.comparison_table(sources) if several else None,
        questions=QUESTIONS,
        about={},
    )


def page_of(
    result: FitResult, folder: str | Path, sections: SectionsOf
) -> Callable[[ResultDocument], str]:
    """Makes the report of a result from its document, before both are written to a folder."""
    return lambda document: report_html([source_of(result, document, folder)], sections)


def _result(source: Source, sections: Iterable[Section], number: int) -> dict[str, Any]:
    """What the template says of one result."""
    document, drawn = source.document, figures(source)
    verdict = UNJUDGED if document.verdict is None else document.verdict
    before, after = (
        distances(source, d) if d else np.empty(0)
        for d in (source.table.differences_before, source.table.differences_after)
    )
    return {
        "name": source.name,
        "title": source.title,
        "id": f"r{number}",
        "document": document,
        "verdict": verdict,
        "headline": verdict.headline,
        "findings": {
            question: [one for one in document.findings if one.question == question]
            for question in QUESTIONS
        },
        "record": top.record(source),
        "bars": top.accuracy_bars(document),
        "region": top.region_bars(source),
        "figures": drawn,
        "images": [key for key in drawn if key.startswith(OF_IMAGES)],
        "image_table": image_table(source),
        "sections": {section.key: section for section in sections},
        "accuracy": tables.accuracy_tables(document),
        "worst": tables.worst_table(source, before, after),
        "models": tables.model_table(document),
        "sensors": tables.sensor_table(source),
        "reliability": tables.reliability_table(document),
        "terms": tables.term_table(document),
        "learnt": [words for term in document.terms for words in term.sentences],
        "parameters": parameter_groups(source),
        "outliers": tables.outlier_table(document),
        "facts": tables.facts_table(document),
        "identifiability": identifiability_words(document),
        "method": method_named(document.method).description,
        "inputs": json.dumps(plain(document.inputs), indent=1, ensure_ascii=False),
    }


def identifiability_words(document: ResultDocument) -> list[str]:
    """Which directions the poses determine, which hardly, which not at all.

    Those that a parameter of the learnt model error takes part in are left out. Its learnt sd holds
    them, so there is nothing to do about them.
    """
    identifiability = document.identifiability
    shown = {p.name for p in shown_parameters(document.parameters, document.terms)}
    words = [f"{identifiability.rank} of {identifiability.parameters} parameters are determined."]
    words += [f"Not determined: {entry.words}" for entry in identifiability.not_identifiable]
    weak = identifiability.weak_directions or ()
    words += [entry.words for entry in weak if shown.issuperset(entry.combination)]
    learned = [
        entry for entry in identifiability.data_versus_prior or () if entry.parameter in shown
    ]
    words += [entry.words for entry in learned if entry.ratio > LITTLE]
    return words


# The parameters grouped by owner, each with its meaning and its change drawn beside its sd.

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
    """head: names of the columns; groups: in the order of the machine; by: what they are."""

    head: tuple[str, ...]
    groups: tuple[Group, ...]
    by: str = "joint"

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells, with the room of the bar."""
        return [(*line.cells, " " * CELL) for group in self.groups for line in group.lines]


def parameter_groups(source: Source) -> ParameterGroups:
    """The parameters of a result, without the many of its model error."""
    document = source.document
    shown = shown_parameters(document.parameters, document.terms)
    reach = _reach(shown)
    kinds = {p.owner: _KINDS[p.role] for p in shown if p.role in _KINDS}
    grouped: dict[str, list[Line]] = {}
    for entry in shown:
        line = _line(entry, reach.get(entry.unit, 0.0), document)
        kind, name = kinds.get(entry.owner), entry.owner or REST
        name = name if kind in (None, name) else f"{kind} {name}"
        grouped.setdefault(name, []).append(line)
    groups = tuple(Group(name, tuple(lines)) for name, lines in grouped.items())
    by = "part: robot, cameras, boards" if kinds else "joint"
    return ParameterGroups((*parameter_head(document), "change, 2 sd"), groups, by)


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


def report(result: Any, out: str | Path = "report.html") -> Path:
    """Write the report of a result, one self-contained HTML page, and return its path.

    result: of `calibrate` or `read_result`, or the path of its folder. Raises InputError for
    anything else, and where the page cannot be written.
    """
    write_atomic(Path(out), html_of(result))
    return Path(out)


def html_of(result: Any) -> str:
    """The page of the report."""
    if isinstance(result, str | Path):
        return report_html([read_source(result)], called("sections"))
    if not hasattr(result, "source"):
        raise InputError(
            f"a {type(result).__name__} is no result",
            code="invalid-value",
            remedy="give what lc.calibrate or lc.read_result returns, or the path of a folder",
        )
    return report_html([result.source], called("sections"))
