"""Bars side by side, one of each series at every name, with the lines of their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.figures.figure import axis, ends, layout, names, numbers


@dataclass(frozen=True)
class Bars:
    """One series: a value at every name, and the ends of its interval, None where unknown."""

    name: str
    shade: str
    values: Sequence[float]
    low: Sequence[float | None] | None = None
    high: Sequence[float | None] | None = None

    def trace(self, labels: Sequence[str]) -> dict[str, Any]:
        """In plotly's terms."""
        made: dict[str, Any] = {
            "type": "bar",
            "name": self.name,
            "x": names(labels),
            "y": numbers(np.array(self.values)),
            "marker": {"color": self.shade},
        }
        if self.low is None or self.high is None:
            return made
        # A missing end is drawn as the value itself: no line to that side.
        low, high = (
            np.array([v if end is None else end for v, end in zip(self.values, s, strict=True)])
            for s in (self.low, self.high)
        )
        return made | {"error_y": ends(np.array(self.values), low, high)}


def bar_layout(height: int, title: str) -> dict[str, Any]:
    """Groups from zero; title: of the axis of values."""
    return layout(
        height,
        barmode="group",
        xaxis=axis("", type="category"),
        yaxis=axis(title, rangemode="tozero"),
    )
