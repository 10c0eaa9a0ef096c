"""What changed on a machine and what would not have been seen; how machines of one type differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    MARK,
    Figure,
    axis,
    colours,
    interval,
    layout,
    names,
    numbers,
    shown_text,
    trace,
    upright,
)
from loopcal.presentation.shown import shortened


@dataclass(frozen=True)
class Reach:
    """A candidate in the unit of the figure: the change that is seen; found, half: the change that
    was found and half its 95 % interval, None where none was."""

    name: str
    smallest: float
    change: float | None
    half: float | None


def changes(key: str, unit: str, candidates: Sequence[Reach]) -> Figure | None:
    """Changes of one unit beside the smallest ones that are seen; None without any."""
    if not candidates:
        return None
    shown = sorted(candidates, key=lambda one: -one.smallest)
    labels = names([one.name for one in shown])
    smallest = np.array([one.smallest for one in shown])
    data = [_bars("smallest change that is seen with 90 %", smallest, labels, BEFORE)]
    changed = [one for one in shown if one.change is not None]
    if changed:
        sizes, halves = np.array([(abs(o.change or 0.0), o.half or 0.0) for o in changed]).T
        words, labels = "change that was found, 95 % interval", names([o.name for o in changed])
        look = {"color": MARK, "size": 9}
        data.append(trace("markers", words, sizes, labels, error_x=interval(halves), marker=look))
    return Figure(
        key,
        f"Changes in {unit}",
        "A change to the left of its bar is not always seen.",
        f"The smallest visible change of {len(shown)} candidates, {len(changed)} changes found.",
        tuple(data),
        layout(
            110 + 22 * len(shown),
            xaxis=axis(f"change [{shown_text(unit)}]", type="log"),
            yaxis=axis(""),
        ),
    )


def narrowed(
    key: str, unit: str, parameters: Sequence[str], before: Array, after: Array
) -> Figure | None:
    """Sds of parameters (n,) of one unit before an update and after it; None without any."""
    if not len(parameters):
        return None
    order = np.argsort(-before)
    labels = names([parameters[i] for i in order])
    stages = (("before", before, BEFORE), ("updated", after, AFTER))
    data = [_bars(name, sds[order], labels, colour) for name, sds, colour in stages]
    return Figure(
        key,
        f"Sds in {unit} before and after the update",
        "Before: of the earlier calibration, with the stated drift. The less an sd falls, the less "
        "the new poses say of this parameter.",
        f"Sds of {len(parameters)} parameters before and after an update.",
        tuple(data),
        layout(
            110 + 30 * len(parameters),
            barmode="group",
            xaxis=axis(f"sd [{shown_text(unit)}]", type="log"),
            yaxis=axis("", autorange="reversed"),
        ),
    )


def spread(parameters: Sequence[str], machines: Mapping[str, Array], unusual: set[str]) -> Figure:
    """Deviations of machines (n,) from the others, as normal deviates."""
    colour = colours(machines)
    labels = names(parameters)
    plain, odd = {"size": 9, "symbol": "circle"}, {"size": 12, "symbol": "diamond"}
    data = [
        trace(
            "markers",
            name,
            values,
            labels,
            marker={"color": MARK, **odd} if name in unusual else {"color": colour[name], **plain},
        )
        for name, values in machines.items()
    ]
    band = {"type": "rect", "xref": "x", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    look = {"fillcolor": AFTER, "opacity": 0.12, "line": {"width": 0}}
    return Figure(
        "spread",
        "Machines beside each other",
        "Deviation from the mean of the other machines, as the normal deviate of the same "
        "probability. The band holds 95 % of the deviations of ordinary machines. Diamonds are "
        "unusual machines.",
        f"Deviations of {len(machines)} machines in {len(parameters)} parameters.",
        tuple(data),
        layout(
            130 + 26 * len(parameters),
            xaxis=axis("deviation [sds]", zeroline=True),
            yaxis=axis("", autorange="reversed"),
            # Deviates are normal by construction, so 1.96 bounds 95 % of them.
            shapes=[{**band, "x0": -1.96, "x1": 1.96, **look}],
        ),
    )


def _bars(name: str, values: Array, labels: Sequence[str], colour: str) -> dict[str, Any]:
    level = {"type": "bar", "orientation": "h", "name": name}
    return {**level, "y": labels, "x": numbers(values), "marker": {"color": colour}}


# A machine over time: its parameters against the first calibration, and its accuracy.

EVENT = 30
"""Characters of an event that stand beside its line; the table of entries holds all."""


@dataclass(frozen=True, eq=False)
class Line:
    """times: ISO; values, half: (n,) a value and half its 95 % interval, in one unit; steps: the
    positions of the first values after a step."""

    name: str
    times: Sequence[str]
    values: Array
    half: Array
    steps: tuple[int, ...] = ()


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
            marker=_marked(len(line.times), line.steps),
        )
        for line in lines
    ]
    title = f"change since the first [{shown_text(unit)}]"
    return Figure(
        key,
        f"Parameters in {unit} over time",
        "Bars are 95 % intervals. Diamonds follow a step. Dashed lines are events. Click a name to "
        "hide it.",
        f"Changes of {len(lines)} parameters over time with 95 % intervals.",
        tuple(data),
        layout(
            460, yaxis=axis(title, zeroline=True), xaxis=axis("", type="date"), **_events(events)
        ),
    )


def _marked(number: int, positions: Sequence[int]) -> dict[str, Any]:
    """Diamonds at these positions, circles elsewhere."""
    marked = [i in positions for i in range(number)]
    shapes = ["diamond" if one else "circle" for one in marked]
    return {"symbol": shapes, "size": [12 if one else 7 for one in marked]}


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
    beyond: list[int] = []
    if weighted is not None:
        outside = (weighted.smooth < weighted.low) | (weighted.smooth > weighted.high)
        beyond = np.flatnonzero(outside).tolist()
    look = {"color": [MARK if i in beyond else BEFORE for i in range(len(x))]}
    look |= _marked(len(x), beyond)
    data = [trace("markers", "rms", x, line.values, marker=look)]
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
        "its own scatter explains: a diamond.",
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
