"""The pages of machines of one type and of a history."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist
from typing import Any

import numpy as np

from loopcal.companions.life.fleet import MACHINE_HEAD, Fleet
from loopcal.companions.life.history import CHANGE_HEAD, ENTRY_HEAD, History, Trend
from loopcal.document.accuracy import Distances
from loopcal.document.plain import rebuilt
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import machine_table, shown_parameters
from loopcal.figures.figure import Figure
from loopcal.figures.life import (
    Event,
    Line,
    Weighted,
    accuracy_chart,
    courses,
    narrowed,
    spread,
)
from loopcal.files.result.deployed import FLEET, HISTORY, VERIFICATION
from loopcal.presentation.shown import Table, by_sd, chance, in_unit, significant, size, unit_shown
from loopcal.report.source import Source
from loopcal.report.templates import Part, Section, section_page
from loopcal.report.verification_page import UNITS, change_figures
from loopcal.statistics.changed import WhatChanged


def fleet_html(fleet: Fleet, files: str) -> str:
    """One self-contained page: mean and spread of each parameter, and which machine is unusual."""
    about = {"files": files, "poses": ", ".join(str(one.poses) for one in fleet.machines)}
    parts: list[Part] = [fleet_figure(fleet), *fleet_tables(fleet)]
    title = f"Machines of one type: {fleet.machine}"
    return section_page("life", Section("l", title, [fleet_words(fleet)], parts), about)


def fleet_words(fleet: Fleet) -> str:
    """What the next machine needs."""
    return " ".join(str(fleet).split("\n\n")[-1].split())


def fleet_figure(fleet: Fleet) -> Figure:
    """Deviations of each machine."""
    deviations = {
        # inv_cdf is not defined at 0; 1e-300 is 37 sds, beyond any figure.
        one.name: np.array(
            [
                math.copysign(NormalDist().inv_cdf(0.5 * min(max(d.p_value, 1e-300), 1.0)), d.value)
                for d in one.deviations
            ]
        )
        for one in fleet.machines
    }
    unusual = {one.name for one in fleet.unusual}
    return spread([p.name for p in fleet.parameters], deviations, unusual)


def fleet_tables(fleet: Fleet) -> list[Table]:
    """The machines, and the parameters over them."""
    parameters = Table(
        "Parameters over the machines",
        ("parameter", "unit", "mean", "spread", "95 % interval", "prior sd", "poses"),
        tuple(
            (
                p.name,
                unit_shown(p.unit),
                by_sd(p.mean, p.mean_sd, p.unit),
                size(p.spread, p.unit, 2),
                f"{size(p.low, p.unit, 2)} to {size(p.high, p.unit, 2)}",
                size(p.prior_sd, p.unit, 2),
                str(p.poses),
            )
            for p in fleet.parameters
        ),
    )
    machines = Table("Machines", MACHINE_HEAD, tuple(fleet.machine_rows()))
    return [machines, parameters]


# The page of a machine's history: entries, parameters, accuracy and events over time.

# Half of the 95 % interval of a normal distribution, in sds.
_WIDE = 1.96


def history_html(history: History) -> str:
    """One self-contained page; nothing in it is asked of any network."""
    entries, name = history.entries, history.entries.folder.name
    words = history.words()
    words += [f"Skipped: {one.file}: {one.reason}" for one in entries.skipped]
    section = Section("h", f"History of {name}", words, history_parts(history))
    return section_page("history", section, {"folder": name, "entries": len(entries.whole)})


def history_parts(history: History) -> list[Figure | Table]:
    """Figures, changes and entries."""
    changed = change_table(history)
    tables = [history_table(history)] if changed is None else [changed, history_table(history)]
    return [*history_figures(history), *tables]


def history_figures(history: History) -> list[Figure]:
    """Accuracy and parameters over time, a figure of each unit, with the events."""
    events = [Event(e.day.isoformat(), e.content["words"]) for e in history.of_kind("event")]
    figures: list[Figure | None] = []
    measured = history.measured
    if measured:
        unit = measured[0].content["unit"]
        values = np.array([in_unit(v, unit) for v in history.accuracy])
        line = Line("rms", [e.day.isoformat() for e in measured], values, np.zeros(len(values)))
        chart, weighted = history.chart, None
        if chart is not None:
            parts = (chart.smooth, chart.low, chart.high)
            weighted = Weighted(*(np.array([in_unit(v, unit) for v in p]) for p in parts))
        figures.append(accuracy_chart(unit_shown(unit), line, weighted, events))
    named = {"m": "lengths", "rad": "angles"}
    for unit in dict.fromkeys(trend.unit for trend in history.trends):
        several = [one for one in history.trends if one.unit == unit and len(one.times) > 1]
        key = named.setdefault(unit, f"others_{len(named)}")
        figures.append(
            courses(key, unit_shown(unit), [_line(one, history) for one in several], events)
        )
    return [figure for figure in figures if figure is not None]


def _line(trend: Trend, history: History) -> Line:
    values, sds = (
        np.array([in_unit(v, trend.unit) for v in series]) for series in (trend.values, trend.sds)
    )
    at = [one.at for one in history.changes if trend.name in one.causes]
    steps = [i for i, number in enumerate(trend.numbers) if number in at]
    return Line(trend.name, trend.times, values, _WIDE * sds, tuple(steps))


def change_table(history: History) -> Table | None:
    """The changes of the machine; None where none is seen."""
    rows = tuple(tuple(change.row()) for change in history.changes)
    caption = "Changes of the machine, with 95 % intervals"
    return Table(caption, CHANGE_HEAD, rows) if rows else None


def history_table(history: History) -> Table:
    """The entries by the day of their measurement."""
    return Table("Entries", ENTRY_HEAD, tuple(history.rows()))


# What was found of a result on other days, for its report: update, verifications, history,
# fleet.


Parts = tuple[list[str], list[Table | Figure]]


def other_days(source: Source) -> Section | None:
    """What a result, if it is an update, and its notes say of other days; None: nothing."""
    notes = [note for note in source.deployed if note.kind in _OF_KIND]
    if not notes and not source.document.updated:
        return None
    words, parts = _update(source.document)
    for number, note in enumerate(notes, 1):
        try:
            sentences, shown = _OF_KIND[note.kind](note.document)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            # What a damaged note raises depends on the damage, since its content is not checked.
            words.append(f"A note of this {note.kind} is damaged. Run the command again.")
            continue
        words += sentences
        parts += [
            replace(one, key=f"{one.key}_{number}") if isinstance(one, Figure) else one
            for one in shown
        ]
    parts.sort(key=lambda one: isinstance(one, Figure))
    return Section("later", "Other days", words, parts)


def _update(document: ResultDocument) -> Parts:
    """By how much an update narrowed what the earlier calibration knew."""
    estimates = [
        (p.name, p.unit, p.prior_sd, p.sd)
        for p in shown_parameters(document.parameters, document.terms)
        if not p.fixed and p.prior_sd and p.sd
    ]
    if not document.updated or not estimates:
        return [], []
    shares = [sd / before for _, _, before, sd in estimates]
    words = (
        f"This result updates an earlier calibration: the sds of {len(estimates)} parameters are "
        f"{significant(min(shares), 2)} to {significant(max(shares), 2)} times those before."
    )
    drawn: list[Table | Figure] = []
    for unit in dict.fromkeys(unit for _, unit, _, _ in estimates):
        group = [one for one in estimates if one[1] == unit]
        sds = np.array([[in_unit(v, unit) for v in one[2:]] for one in group])
        key = f"sds_{UNITS.get(unit, 'others')}"
        figure = narrowed(key, unit_shown(unit), [one[0] for one in group], *sds.T)
        drawn += [] if figure is None else [figure]
    return [words], drawn


def _verification(document: Mapping[str, Any]) -> Parts:
    file, answers = document["readings"], document["verdict"]
    words = [f"{file}, {document['poses']} poses: {answers['headline']}"]
    words += [
        f"{file}: {answer['next']}"
        for name, answer in answers.items()
        if name != "headline" and answer["next"] and answer["passed"] is False
    ]
    unit, accuracy = document["accuracy"]["unit"], document["accuracy"]
    distances = {
        name: None if accuracy[name] is None else Distances(**accuracy[name])
        for name in ("nominal", "calibrated", "expected")
    }
    reached = machine_table(f"Accuracy: {file}", unit, distances)
    if document["changes"] is None:
        return words, [reached]
    what_changed = WhatChanged.from_document(document["changes"], document["chi_squared"])
    drawn = [replace(one, title=f"{one.title}: {file}") for one in change_figures(what_changed)]
    return words, [_changes(file, what_changed), reached, *drawn]


def _changes(file: str, what_changed: WhatChanged) -> Table:
    rows = [
        (
            one.where,
            by_sd(one.value, one.sd, one.unit),
            size(0.5 * (one.high - one.low), one.unit, 2),
            unit_shown(one.unit),
            chance(one.p_value),
            ", ".join(other.words for other in one.alike),
        )
        for one in what_changed.found
    ]
    if not rows:
        rows = [("no change is seen", "", "", "", chance(what_changed.test.p_value), "")]
    head = ("what changed", "change", "U95", "unit", "p", "not distinguishable at these poses")
    return Table(f"What changed: {file}", head, tuple(rows))


def _history(document: Mapping[str, Any]) -> Parts:
    history = History.from_document(document)
    table = replace(history_table(history), caption="History of the machine")
    changed = change_table(history)
    return [], [table, *([] if changed is None else [changed]), *history_figures(history)]


def _fleet(document: Mapping[str, Any]) -> Parts:
    fleet = rebuilt(Fleet, document)
    return [fleet_words(fleet)], [*fleet_tables(fleet), fleet_figure(fleet)]


_OF_KIND = {VERIFICATION: _verification, HISTORY: _history, FLEET: _fleet}
