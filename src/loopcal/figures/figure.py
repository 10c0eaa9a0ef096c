"""A figure as data: traces and layout in plotly's terms, its caption and its text alternative."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array

BEFORE, AFTER = "#8d8f96", "#2b7bd6"
"""Colours before and after a calibration, legible on light and on dark."""
MARK = "#b3261e"
COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00"),
    *("#56b4e9", "#8c510a", "#7570b3", "#b2a800", "#6b7280"),
)
"""Distinct also without green cones (deuteranopia); the first eight after Okabe and Ito."""


WIDTH, LEGEND_ROW, LEGEND_MARK, LEGEND_LETTER = 700, 20, 45, 7
"""[px] of a figure on paper, and of the entries of its legend."""


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name, the same in every figure of a page."""
    return {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(dict.fromkeys(names))}


@dataclass(frozen=True, eq=False)
class Figure:
    """caption: what to see in it; label: the text alternative; data, layout: plotly's.

    least_width: [px] below which its labels cannot be read, so that it scrolls; 0: none.
    """

    key: str
    title: str
    caption: str
    label: str
    data: tuple[Mapping[str, Any], ...]
    layout: Mapping[str, Any]
    least_width: int = 0

    def marked(self, poses: Mapping[int, str]) -> Figure:
        """A figure over the poses with a line before each of these: number from 1 -> its id."""
        if not poses:
            return self
        lines = [upright(n - 0.5, MARK, 1.5) | {"xref": "x"} for n in poses]
        listed = ", ".join(poses.values())
        words = f" Dashed line: something changed here (from pose {listed} on)."
        layout = {**self.layout, "shapes": lines}
        return replace(self, caption=self.caption + words, layout=layout)

    @property
    def height(self) -> int:
        """[px] The layout's, with the room of a legend of many or long names.

        Plotly lays the entries out in columns of one width and cuts a legend at half the height.
        """
        height = int(self.layout["height"])
        named = [t for t in self.data if t.get("showlegend", True) and t.get("name")]
        shown = [t for t in named if t.get("visible", True)]
        if len(shown) < 2 or not self.layout.get("showlegend", True):
            return height
        widest = max(LEGEND_MARK + LEGEND_LETTER * len(str(trace["name"])) for trace in shown)
        rows = -(-len(shown) // max(WIDTH // widest, 1))
        return max(height + LEGEND_ROW * max(rows - 2, 0), 2 * LEGEND_ROW * (rows + 1))

    def json(self) -> str:
        """For a script element: nothing in it can end that element or begin a comment."""
        layout = {**self.layout, "height": self.height}
        content = {"data": self.data, "layout": layout}
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
        return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")

    def plotly(self) -> Any:
        """As a plotly figure with its title, which a notebook shows."""
        from plotly.graph_objects import Figure as PlotlyFigure

        drawn = PlotlyFigure({"data": list(self.data), "layout": dict(self.layout)})
        margin = {**self.layout["margin"], "t": 90}
        height = self.layout["height"] + 70
        return drawn.update_layout(title={"text": self.title}, margin=margin, height=height)


def numbers(values: Array) -> list[Any]:
    """Numbers to six significant digits, finer than any screen; None where there is none."""
    return [float(f"{v:.6g}") if v - v == 0.0 else None for v in values.tolist()]


def shown_text(text: str) -> str:
    """A user's text for plotly, which reads some markup: shown as it was written."""
    return escape(text, quote=False)


def panel_title(name: str, words: str = "", most: int = 22) -> str:
    """A name beside a panel, cut to the end of `most` characters, and words after it."""
    short = name if len(name) <= most else f"…{name[1 - most :]}"
    return shown_text(f"{short}, {words}" if words else short)


def names(texts: Sequence[str]) -> list[str]:
    """Several texts for plotly."""
    return [shown_text(text) for text in texts]


def trace(
    mode: str, name: str, x: Array | Sequence[Any], y: Array | Sequence[Any], **more: Any
) -> dict[str, Any]:
    """Points, lines or both in a plane; arrays to the digits of `numbers`, others as they are."""
    at = {k: numbers(v) if isinstance(v, np.ndarray) else [*v] for k, v in (("x", x), ("y", y))}
    return {"type": "scatter", "mode": mode, "name": shown_text(name), **at, **more}


def spots(mode: str, at: Array, **more: Any) -> dict[str, Any]:
    """Points (d, N) in a plane or in space, joined or not."""
    kind = "scatter" if len(at) == 2 else "scatter3d"
    return {"type": kind, "mode": mode, **dict(zip("xyz", map(numbers, at), strict=False)), **more}


def upright(x: float | str, colour: str, width: float) -> dict[str, Any]:
    """A dashed line over the whole height."""
    look = {"color": colour, "width": width, "dash": "dash"}
    return {"type": "line", "yref": "paper", "x0": x, "x1": x, "y0": 0, "y1": 1, "line": look}


def interval(half: Array, thickness: float = 1.5) -> dict[str, Any]:
    """Lines so far to both sides."""
    return {"type": "data", "array": numbers(half), "thickness": thickness}


def ends(values: Array, low: Array, high: Array, thickness: float = 1.5) -> dict[str, Any]:
    """Lines from values down to low and up to high."""
    below = {"symmetric": False, "arrayminus": numbers(values - low)}
    return {**interval(high - values, thickness), **below}


COLUMNS = 3
"""Panels side by side."""


@dataclass(frozen=True)
class Panel:
    """One of several in rows of three. suffix: of its axes; left, top: its corner, in shares of the
    figure; rows: how many there are."""

    suffix: str
    left: float
    top: float
    rows: int

    @property
    def axes(self) -> dict[str, str]:
        """That a trace names to be drawn in it."""
        return {"xaxis": f"x{self.suffix}", "yaxis": f"y{self.suffix}"}

    def titled(self, text: str, right: float = 0.0, below: float = 0.0) -> dict[str, Any]:
        """A title, so far right of its corner and below it."""
        place = {"x": self.left + right, "y": self.top - below, "xref": "paper", "yref": "paper"}
        return {"text": text, **place, "xanchor": "left", "yanchor": "bottom", "showarrow": False}


def panels(count: int) -> list[Panel]:
    """So many."""
    rows = -(-count // COLUMNS)
    cells = (divmod(i, COLUMNS) for i in range(count))
    return [Panel(suffix(i), c / COLUMNS, 1.0 - r / rows, rows) for i, (r, c) in enumerate(cells)]


def suffix(number: int) -> str:
    """What names the axes of a panel, counted from 0, as plotly counts."""
    return str(number + 1) if number else ""


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with a title of its own."""
    # 20000, never 20k
    plain = {"exponentformat": "power", "minexponent": 6}
    return {"title": {"text": title}, "automargin": True, **plain, **more}


def layout(height: int, **more: Any) -> dict[str, Any]:
    """What all figures have in common; colours of text and grid are those of the page."""
    return {
        "height": height,
        "margin": {"l": 8, "r": 8, "t": 16, "b": 8},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        **more,
    }


def plotly_javascript() -> str:
    """The program that draws the figures, from the installed plotly."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


# Bars side by side, one of each series at every name, with the lines of their intervals.


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


# Which poses a figure shows where there are more than an eye, or a browser, can take.

# Markers that a browser draws without delay.
POINTS = 2000
LARGEST = 50
"""How many of the poses shown are those where the figure is largest."""


@dataclass(frozen=True, eq=False)
class Thinned:
    """index: (k,) poses to show, in order; words: what was left out, "" where nothing was."""

    index: NDArray[np.intp]
    words: str


def thinned(sizes: NDArray[np.float64], most: int = POINTS, what: str = "poses") -> Thinned:
    """At most `most` of the poses with sizes (N,): evenly chosen, and the largest; NaN are none."""
    usable = np.flatnonzero(np.isfinite(sizes))
    if usable.size <= most:
        return Thinned(usable, "")
    largest = min(LARGEST, most // 2)
    even = usable[np.linspace(0, usable.size - 1, most - largest).astype(np.intp)]
    top = usable[np.argsort(np.abs(sizes[usable]))[-largest:]]
    index = np.union1d(even, top)
    return Thinned(
        index,
        f" Shown are {index.size:,} of {usable.size:,} {what}, evenly chosen, with the "
        f"{largest} largest among them; all numbers of this report come from all poses.",
    )
