"""A machine over time: its parameters against the first calibration, and its accuracy."""

from __future__ import annotations

from collections.abc import Sequence
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
    interval,
    layout,
    shown_text,
    trace,
    upright,
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
    data = [
        trace(
            "lines+markers",
            line.name,
            line.times,
            line.values - line.values[0],
            error_y=interval(line.half, 1.2),
            line={"color": colour[line.name]},
        )
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
    x = line.times
    data = [trace("markers", "rms", x, line.values, marker={"color": BEFORE})]
    if weighted is not None:
        dashed = {"color": MARK, "dash": "dot"}
        data += [
            trace("lines", "EWMA", x, weighted.smooth, line={"color": AFTER}),
            trace("lines", "limits", x, weighted.low, line=dashed),
            trace("lines", "limits", x, weighted.high, line=dashed, showlegend=False),
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
    # Upright beside its line, so that neighbouring events do not cover each other.
    words = {"yref": "paper", "y": 1, "showarrow": False, "textangle": -90, "xanchor": "right"}
    return {
        "shapes": [upright(e.time, MARK, 1.5) for e in events],
        "annotations": [
            {**words, "x": e.time, "text": shown_text(shortened(e.words, EVENT))} for e in events
        ],
    }
