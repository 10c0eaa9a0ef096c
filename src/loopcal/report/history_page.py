"""The page of a machine's history: entries, parameters, accuracy and events over time."""

from __future__ import annotations

import numpy as np

from loopcal.figures.figure import Figure, plotly_javascript
from loopcal.figures.history import Event, Line, Weighted, accuracy_chart, courses
from loopcal.files.versions import version
from loopcal.life.history import History, Trend
from loopcal.presentation.shown import in_unit, unit_shown, with_unit
from loopcal.report.tables import Table
from loopcal.report.templates import environment, part, sha256

_WIDE = 1.96


def history_html(history: History) -> str:
    """One self-contained page; nothing in it is asked of any network."""
    program, drawing = plotly_javascript(), part("draw.js")
    entries = history.entries
    return (
        environment()
        .get_template("history.html")
        .render(
            title=f"History of {entries.folder.name}",
            version=version(),
            history={
                "id": "h",
                "figures": {figure.key: figure for figure in history_figures(history)},
            },
            skipped=entries.skipped,
            outside=history.chart is not None and history.chart.outside,
            entries=history_table(history),
            style=part("style.css"),
            program=program,
            drawing=drawing,
            hashes=" ".join(f"'sha256-{sha256(text)}'" for text in (program, drawing)),
        )
    )


def history_figures(history: History) -> list[Figure]:
    """Parameters and accuracy over time, with the events."""
    events = [Event(e.time.isoformat(), e.content["words"]) for e in history.of_kind("event")]
    found = []
    for unit in dict.fromkeys(trend.unit for trend in history.trends):
        several = [one for one in history.trends if one.unit == unit and len(one.times) > 1]
        lines = [_line(trend) for trend in several]
        key = {"m": "lengths", "rad": "angles"}.get(unit, "others")
        found.append(courses(key, unit_shown(unit), lines, events))
    measured = history.measured
    if measured:
        unit = measured[0].content["unit"]
        values = np.array([in_unit(v, unit) for v in history.accuracy])
        line = Line("rms", [e.time.isoformat() for e in measured], values, np.zeros(len(values)))
        its, weighted = history.chart, None
        if its is not None:
            parts = (its.smooth, its.low, its.high)
            weighted = Weighted(*(np.array([in_unit(v, unit) for v in p]) for p in parts))
        found.append(accuracy_chart(unit_shown(unit), line, weighted, events))
    return [figure for figure in found if figure is not None]


def _line(trend: Trend) -> Line:
    values, sds = (
        np.array([in_unit(v, trend.unit) for v in its]) for its in (trend.values, trend.sds)
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
