"""The page of a machine's history: entries, parameters, accuracy and events over time."""

from __future__ import annotations

import numpy as np

from loopcal.figures.figure import Figure
from loopcal.figures.history import Event, Line, Weighted, accuracy_chart, courses
from loopcal.life.history import History, Trend
from loopcal.presentation.shown import in_unit, unit_shown, with_unit
from loopcal.presentation.text_table import Table
from loopcal.report.section import Section, section_page

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
