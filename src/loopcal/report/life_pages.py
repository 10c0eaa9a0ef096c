"""The pages of a verification and of machines of one type."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from loopcal.figures.figure import Figure
from loopcal.figures.life import (
    Event,
    Line,
    Reach,
    Weighted,
    accuracy_chart,
    changes,
    courses,
    spread,
)
from loopcal.life.fleet import Fleet
from loopcal.life.history import History, Trend
from loopcal.presentation.shown import Table, by_sd, chance, in_unit, size, unit_shown, with_unit
from loopcal.report.section import Part, Section, section_page
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.verified import Verification

UNITS = {"m": "lengths", "rad": "angles"}


def verification_html(verification: Verification, title: str, files: str) -> str:
    """One self-contained page: the answers, what changed, and the accuracy; files: compared."""
    answers = Table(
        "Answers",
        ("question", "answer", "why", "what to do"),
        tuple(
            (name, {True: "yes", False: "no", None: "open"}[a.passed], a.words, a.next or "")
            for name, a in verification.verdict.items()
        ),
    )
    parts: list[Part] = [answers, *(table for table in verification.tables if table.rows)]
    if verification.changes is not None:
        lines = "\n".join(verification.changes.lines())
        parts = [lines, *change_figures(verification.changes), *parts]
    section = Section("l", f"Verification of {title}", [verification.headline], parts)
    return section_page("life", section, {"files": files, "poses": len(verification.poses)})


def change_figures(what_changed: WhatChanged) -> list[Figure]:
    """What changed, and what would not have been seen: one figure for each unit."""
    units = dict.fromkeys(one.unit for one in what_changed.candidates)
    drawn = [
        changes(UNITS.get(u, "others"), unit_shown(u), _reaches(what_changed, u)) for u in units
    ]
    return [figure for figure in drawn if figure is not None]


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
    machines = Table(
        "Machines",
        ("machine", "poses", "p", "result"),
        tuple(
            (
                one.name,
                str(one.poses),
                chance(one.p_value),
                f"unusual: {', '.join(one.outstanding)}" if one.unusual else "like the others",
            )
            for one in fleet.machines
        ),
    )
    return [machines, parameters]


def _reaches(what_changed: WhatChanged, unit: str) -> list[Reach]:
    changed = {one.name: one for one in what_changed.found}
    reaches = []
    for one in what_changed.candidates:
        if one.unit != unit or one.smallest is None:
            continue
        change = changed.get(one.name)
        value = None if change is None else in_unit(change.value, unit)
        half = None if change is None else in_unit(0.5 * (change.high - change.low), unit)
        reaches.append(Reach(one.words, in_unit(one.smallest, unit), value, half))
    return reaches


# The page of a machine's history: entries, parameters, accuracy and events over time.

# Half of the 95 % interval of a normal distribution, in sds.
_WIDE = 1.96
_ORDER = ("accuracy", "lengths", "angles", "others")
"""Keys of the figures."""


def history_html(history: History) -> str:
    """One self-contained page; nothing in it is asked of any network."""
    entries, name = history.entries, history.entries.folder.name
    outside = history.chart is not None and history.chart.outside
    words = ["The accuracy is outside its limits (EWMA). Verify the machine."] if outside else []
    words += [f"Skipped: {one.file}: {one.reason}" for one in entries.skipped]
    figures = {one.key: one for one in history_figures(history)}
    parts = [*map(figures.get, _ORDER), history_table(history)]
    section = Section("h", f"History of {name}", words, parts)
    return section_page("history", section, {"folder": name, "entries": len(entries.whole)})


def history_figures(history: History) -> list[Figure]:
    """Parameters and accuracy over time, with the events."""
    events = [Event(e.time.isoformat(), e.content["words"]) for e in history.of_kind("event")]
    figures = []
    for unit in dict.fromkeys(trend.unit for trend in history.trends):
        several = [one for one in history.trends if one.unit == unit and len(one.times) > 1]
        lines = [_line(trend) for trend in several]
        key = {"m": "lengths", "rad": "angles"}.get(unit, "others")
        figures.append(courses(key, unit_shown(unit), lines, events))
    measured = history.measured
    if measured:
        unit = measured[0].content["unit"]
        values = np.array([in_unit(v, unit) for v in history.accuracy])
        line = Line("rms", [e.time.isoformat() for e in measured], values, np.zeros(len(values)))
        chart, weighted = history.chart, None
        if chart is not None:
            parts = (chart.smooth, chart.low, chart.high)
            weighted = Weighted(*(np.array([in_unit(v, unit) for v in p]) for p in parts))
        figures.append(accuracy_chart(unit_shown(unit), line, weighted, events))
    return [figure for figure in figures if figure is not None]


def _line(trend: Trend) -> Line:
    values, sds = (
        np.array([in_unit(v, trend.unit) for v in series]) for series in (trend.values, trend.sds)
    )
    return Line(trend.name, trend.times, values, _WIDE * sds)


def history_table(history: History) -> Table:
    """The entries in their order."""
    rows = tuple(
        (
            str(e.sequence),
            f"{e.time:%Y-%m-%d %H:%M}",
            e.kind,
            "" if e.content.get("rms") is None else with_unit(e.content["rms"], e.content["unit"]),
            e.content["words"],
        )
        for e in history.entries.whole
    )
    return Table("Entries", ("number", "UTC", "entry", "rms", "result"), rows)
