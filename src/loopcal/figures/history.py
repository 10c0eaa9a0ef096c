"""A machine over time: its parameters against the first calibration, and its accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    MARK,
    Array,
    Figure,
    axis,
    colours,
    layout,
    numbers,
    shown_text,
)
from loopcal.presentation.wrapped import shortened

EVENT = 30
"""Characters of an event that stand beside its line; the table of entries holds all."""


@dataclass(frozen=True, eq=False)
class Line:
    """times: ISO; values, half: (n,) a value and half its 95 % interval, in one unit."""

    name: str
    times: Sequence[str]
    values: Array
    half: Array


@dataclass(frozen=True)
class Event:
    """What happened, and when (ISO)."""

    time: str
    words: str


def courses(key: str, unit: str, lines: Sequence[Line], events: Sequence[Event]) -> Figure | None:
    """Parameters of one unit, less their first value; None without any."""
    if not lines:
        return None
    colour = colours(line.name for line in lines)
    data: list[Mapping[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": shown_text(line.name),
            "x": list(line.times),
            "y": numbers(line.values - line.values[0]),
            "error_y": {"type": "data", "array": numbers(line.half), "thickness": 1.2},
            "line": {"color": colour[line.name]},
        }
        for line in lines
    ]
    title = f"change since the first [{shown_text(unit)}]"
    return Figure(
        key,
        f"Parameters in {unit} over time",
        "Bars are 95 % intervals. Dashed lines are events. Click a name to hide it.",
        f"Changes of {len(lines)} parameters over time with 95 % intervals.",
        tuple(data),
        layout(
            460, yaxis=axis(title, zeroline=True), xaxis=axis("", type="date"), **_events(events)
        ),
    )


@dataclass(frozen=True, eq=False)
class Weighted:
    """(n,) exponentially weighted means and their limits."""

    smooth: Array
    low: Array
    high: Array


def accuracy_chart(
    unit: str, line: Line, weighted: Weighted | None, events: Sequence[Event]
) -> Figure:
    """The accuracy with its weighted mean and the limits of that."""
    look: dict[str, Any] = {"type": "scatter", "x": list(line.times)}
    data: list[Mapping[str, Any]] = [
        {
            **look,
            "mode": "markers",
            "name": "rms",
            "y": numbers(line.values),
            "marker": {"color": BEFORE},
        }
    ]
    if weighted is not None:
        dashed = {"color": MARK, "dash": "dot"}
        data += [
            {
                **look,
                "mode": "lines",
                "name": "EWMA",
                "y": numbers(weighted.smooth),
                "line": {"color": AFTER},
            },
            {**look, "mode": "lines", "name": "limits", "y": numbers(weighted.low), "line": dashed},
            {
                **look,
                "mode": "lines",
                "y": numbers(weighted.high),
                "line": dashed,
                "showlegend": False,
            },
        ]
    return Figure(
        "accuracy",
        "Accuracy over time",
        "EWMA: exponentially weighted mean. Beyond a limit the accuracy has changed by more than "
        "its own scatter explains.",
        f"Accuracy at {len(line.times)} entries.",
        tuple(data),
        layout(
            360,
            yaxis=axis(f"rms [{shown_text(unit)}]"),
            xaxis=axis("", type="date"),
            **_events(events),
        ),
    )


def _events(events: Sequence[Event]) -> dict[str, Any]:
    line = {"type": "line", "yref": "paper", "y0": 0, "y1": 1}
    look = {"color": MARK, "width": 1.5, "dash": "dash"}
    # Upright beside its line, so that neighbouring events do not cover each other.
    words = {"yref": "paper", "y": 1, "showarrow": False, "textangle": -90, "xanchor": "right"}
    return {
        "shapes": [{**line, "x0": e.time, "x1": e.time, "line": look} for e in events],
        "annotations": [
            {**words, "x": e.time, "text": shown_text(shortened(e.words, EVENT))} for e in events
        ],
    }
