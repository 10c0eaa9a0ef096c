"""What changed on a machine and what would not have been seen; how machines of one type differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
    names,
    numbers,
    shown_text,
    trace,
)


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
