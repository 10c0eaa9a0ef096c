"""Bars side by side, one of each series at every name, with the lines of their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.figures.figure import axis, layout, names, numbers


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
        intervals = [
            # A missing end is drawn as the value itself: no line to that side.
            (v, v if low is None else low, v if high is None else high)
            for v, low, high in zip(self.values, self.low, self.high, strict=True)
        ]
        lines = {
            "type": "data",
            "symmetric": False,
            "array": numbers(np.array([high - v for v, _, high in intervals])),
            "arrayminus": numbers(np.array([v - low for v, low, _ in intervals])),
            "thickness": 1.5,
        }
        return made | {"error_y": lines}


def bar_layout(height: int, title: str) -> dict[str, Any]:
    """Groups from zero; title: of the axis of values."""
    return layout(
        height,
        barmode="group",
        xaxis=axis("", type="category"),
        yaxis=axis(title, rangemode="tozero"),
    )
