"""Distributions of errors over many draws, method beside method, a printed draw among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.figures.figure import COLOURS, Figure, axis, ends, layout, shown_text, trace


@dataclass(frozen=True)
class ErrorBar:
    """An error over all draws: mean, and the ends of the middle 95 %; printed: of one in print."""

    name: str
    mean: float
    low: float
    high: float
    printed: float | None


def error_bars(
    key: str, title: str, unit: str, methods: Sequence[tuple[str, Sequence[ErrorBar]]]
) -> Figure | None:
    """Middle 95 % of every error [unit] by method, on one scale; None where there are none."""
    shown = [(name, bars) for name, bars in methods if bars]
    if not shown:
        return None
    data: list[dict[str, Any]] = []
    for i, (method, bars) in enumerate(shown):
        at = [k + 0.3 * (i - 0.5 * (len(shown) - 1)) for k in range(len(bars))]
        means, low, high = np.array([(bar.mean, bar.low, bar.high) for bar in bars]).T
        colour = COLOURS[i % len(COLOURS)]
        marker: dict[str, Any] = {"color": colour, "size": 8}
        lines = ends(means, low, high, thickness=3)
        data.append(trace("markers", method, at, means, error_y=lines, marker=marker))
        printed = [(x, b.printed) for x, b in zip(at, bars, strict=True) if b.printed is not None]
        if printed:
            marker = {"symbol": "diamond-open", "color": colour, "size": 11, "line": {"width": 2}}
            x, y = np.array(printed).T
            data.append(trace("markers", f"{method}, printed draw", x, y, marker=marker))
    names = [bar.name for bar in shown[0][1]]
    widest = {method: max(bar.high - bar.low for bar in bars) for method, bars in shown}
    widths_text = ", ".join(
        f"{method} up to {width:.3g} {unit} wide" for method, width in widest.items()
    )
    return Figure(
        key,
        title,
        "Points are means over the draws, bars contain the middle 95 % of them, open diamonds "
        "are the published draw. A mean away from zero is bias. An invisible bar is too short "
        "for this scale.",
        f"{title} by method: {widths_text}.",
        tuple(data),
        layout(
            340,
            xaxis=axis(
                "",
                tickvals=list(range(len(names))),
                ticktext=[shown_text(name) for name in names],
            ),
            yaxis=axis(f"true minus estimate [{unit}]", zeroline=True),
        ),
    )
