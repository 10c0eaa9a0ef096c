"""The pages of machines of one type and of a history."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from loopcal.companions.life.fleet import Fleet
from loopcal.companions.life.history import CHANGE_HEAD, ENTRY_HEAD, History, Trend
from loopcal.figures.figure import Figure
from loopcal.figures.life import (
    Event,
    Line,
    Weighted,
    accuracy_chart,
    courses,
    spread,
)
from loopcal.presentation.shown import Table, by_sd, chance, in_unit, size, unit_shown
from loopcal.report.section import Part, Section, section_page


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
