"""How far the model is from the measured points, before and after: histogram and pose by pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLUMNS,
    POINTS,
    Figure,
    axis,
    colours,
    interval,
    layout,
    names,
    numbers,
    panel_title,
    panels,
    shown_text,
    suffix,
    thinned,
    trace,
)

BINS = 40


def distance_histogram(before: Array, after: Array, unit: str) -> Figure | None:
    """How the distances (N,) [unit] of all poses are distributed; None where there are none."""
    parts = {"before": before[np.isfinite(before)], "after": after[np.isfinite(after)]}
    positive = np.concatenate([part[part > 0.0] for part in parts.values()])
    if not positive.size:
        return None
    # A linear scale of 40 bins would show most of such distances in the first one.
    logarithmic = positive.max() > 30.0 * np.median(positive[positive <= np.median(positive)])
    low = max(positive.min(), positive.max() * 1e-6)
    space = np.geomspace(low, positive.max(), BINS + 1)
    edges = space if logarithmic else np.linspace(0.0, positive.max(), BINS + 1)
    # The largest distance falls into the last bin in spite of rounding.
    edges[-1] = positive.max() * (1.0 + 1e-12)
    data = []
    for (name, values), colour in zip(parts.items(), (BEFORE, AFTER), strict=True):
        counts = np.histogram(np.maximum(values, edges[0]), edges)[0].astype(float)
        line = {"shape": "hv", "color": colour, "width": 2}
        steps = np.append(counts, counts[-1])
        drawn = trace("lines", f"{name} calibration", edges, steps, line=line, fill="tozeroy")
        data.append(drawn)
    scale = {"type": "log"} if logarithmic else {"rangemode": "tozero"}
    hint = " The scale of distances is logarithmic." if logarithmic else ""
    medians = {name: float(np.median(v)) for name, v in parts.items() if v.size}
    medians_text = ", ".join(f"median {m:.3g} {unit} {name}" for name, m in medians.items())
    return Figure(
        "histogram",
        "Distances between computed and measured points",
        "Each step counts the poses at that distance. Where blue lies left of grey, the "
        f"calibration improved them; inspect the poses in the right tail of blue.{hint}",
        f"Histogram of distances before and after calibration: {medians_text}.",
        tuple(data),
        layout(
            300,
            xaxis=axis(f"distance [{unit}]", **scale),
            yaxis=axis("poses", rangemode="tozero"),
        ),
    )


def over_poses(
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    ids: Sequence[str],
    unit: str,
    what: str,
    shades: Mapping[str, str] | None = None,
) -> Figure | None:
    """Values (N,) [unit] against pose number, one panel before and one after; None without any.

    shades: the colour of each name.
    """
    panels = [panel for panel in (before, after) if panel]
    if not panels:
        return None
    shades = shades or colours(name for panel in panels for name in panel)
    sizes = np.nanmax(np.abs(_stack(panels)), axis=0, initial=0.0)
    chosen = thinned(sizes)
    data: list[dict[str, Any]] = []
    for number, panel in enumerate(panels, 1):
        for i, (name, values) in enumerate(panel.items()):
            more = {
                "legendgroup": str(i),
                "showlegend": number == 1,
                "text": names([ids[j] for j in chosen.index]),
                "marker": {"color": shades[name], "size": 4},
                "yaxis": "y" if number == 1 else "y2",
            }
            at = (chosen.index + 1).tolist()
            data.append(trace("markers", name, at, values[chosen.index], **more))
    axes = {"yaxis": axis(f"before [{unit}]", zeroline=True)}
    if len(panels) == 2:
        axes["yaxis"]["domain"] = [0.55, 1.0]
        axes["yaxis2"] = axis(f"after [{unit}]", domain=[0.0, 0.45], zeroline=True, anchor="x")
    worst = [float(np.nanmax(np.abs(_stack([panel])), initial=0.0)) for panel in panels]
    largest_text = " and ".join(
        f"at most {w:.3g} {unit} {when}"
        for w, when in zip(worst, ("before", "after"), strict=False)
    )
    return Figure(
        "residuals",
        f"{what} against pose number",
        "The two panels have different scales. Before: patterns show errors of the nominal "
        "model. After: only scatter without pattern should remain. A drift or step means that "
        f"something moved during the measurement.{chosen.words}",
        f"{what} of {len(sizes)} poses in order, {largest_text}.",
        tuple(data),
        layout(
            520 if len(panels) == 2 else 320,
            xaxis=axis("number of the pose", anchor="y2" if len(panels) == 2 else "y"),
            **axes,
        ),
    )


def _stack(panels: Sequence[Mapping[str, Array]]) -> Array:
    return np.array([values for panel in panels for values in panel.values()])


# Corrections of the readings over their sds: against the normal curve, and over the poses.


NORMAL = "#8d8f96"
"""Colour of the normal curve."""


def normalised(corrections: Mapping[str, Array], shades: Mapping[str, str]) -> Figure | None:
    """Densities of corrections (N,) over their sds, a panel each, beside the normal curve.

    shades: the colour of each sensor. None without any corrections.
    """
    usable = {name: values[np.isfinite(values)] for name, values in corrections.items()}
    usable = {name: values for name, values in usable.items() if values.size}
    if not usable:
        return None
    # Four sds show the shape of a normal curve; beyond twelve one outlier would flatten it.
    reach = min(max(4.0, *(float(np.abs(v).max()) for v in usable.values())), 12.0)
    curve = np.linspace(-reach, reach, 61)
    edges = np.linspace(-reach, reach, 41)
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    titles = []
    every = panels(len(usable))
    rows = every[0].rows
    for panel, (name, values) in zip(every, usable.items(), strict=True):
        end, left, top = panel.suffix, panel.left, panel.top
        right, bottom = left + 0.88 / COLUMNS, top - 0.72 / rows
        quiet = {"showticklabels": False, "rangemode": "tozero", "title": {"text": ""}}
        more[f"xaxis{end}"] = axis("", domain=[left, right], anchor=f"y{end}", nticks=5)
        more[f"yaxis{end}"] = axis("", domain=[bottom, top], anchor=f"x{end}") | quiet
        counts = np.histogram(np.clip(values, -reach, reach), edges)[0]
        density = counts / (values.size * (edges[1] - edges[0]))
        normal = np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi)
        lines = [
            (0.5 * (edges[1:] + edges[:-1]), density, {"shape": "hvh", "width": 1.5}, "tozeroy"),
            (curve, normal, {"dash": "dot", "width": 2, "color": NORMAL}, "none"),
        ]
        for x, y, line, fill in lines:
            look = {"line": {"color": shades[name], **line}, "fill": fill, "hoverinfo": "skip"}
            data.append(trace("lines", name, x, y, **look, **panel.axes))
        rms = float(np.sqrt(np.square(values).mean()))
        titles.append(panel.titled(panel_title(name, f"rms {rms:.2f}")))
    rms_text = ", ".join(
        f"{shown_text(n)} rms {np.sqrt(np.square(v).mean()):.2f}" for n, v in usable.items()
    )
    return Figure(
        "normalised",
        "Corrections over their sds, beside the normal curve",
        "A weakly checked sensor is corrected by less than its sd, so its curve is narrower "
        "than the dotted one. A wider, skewed or two-humped curve: its sd is too small, or its "
        "errors are not only noise. Values beyond the ends are counted at the ends.",
        f"Distributions of corrections over their sds beside the normal curve: {rms_text}.",
        tuple(data),
        layout(150 * rows + 40, annotations=titles, showlegend=False, **more)
        | {"margin": {"l": 8, "r": 8, "t": 32, "b": 8}},
    )


def drift(
    corrections: Mapping[str, Array], ids: Sequence[str], shades: Mapping[str, str]
) -> Figure | None:
    """Corrections (N,) over their sds against pose number, a panel each; None without any.

    shades: the colour of each sensor.
    """
    usable = {n: v for n, v in corrections.items() if np.isfinite(v).any()}
    if not usable:
        return None
    count = len(usable)
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    words = ""
    for i, (name, values) in enumerate(usable.items()):
        chosen = thinned(values, max(POINTS * 4 // count, 300) if count > 4 else POINTS)
        words = words or chosen.words
        top = 1.0 - i / count
        domain = [top - 0.88 / count, top]
        more[f"yaxis{suffix(i)}"] = axis(
            panel_title(name, most=12), domain=domain, zeroline=True, nticks=4
        )
        look = {
            "showlegend": False,
            "text": names([ids[j] for j in chosen.index]),
            "marker": {"color": shades[name], "size": 3},
            "yaxis": f"y{suffix(i)}",
        }
        at = (chosen.index + 1).tolist()
        data.append(trace("markers", name, at, values[chosen.index], **look))
    anchor = "y" if count == 1 else f"y{count}"
    return Figure(
        "drift",
        "Corrections over their sds against pose number",
        "Each panel should be a level band without pattern. A slope is drift, a step is a "
        f"disturbance, waves are errors that depend on position.{words}",
        f"Corrections over their sds against pose number, one panel for each of {count} sensors.",
        tuple(data),
        layout(
            110 * count + 80,
            xaxis=axis("number of the pose", anchor=anchor),
            showlegend=False,
            **more,
        ),
    )


# The estimated parameters: changes with 95 % intervals, and a map of their correlations.

WIDE = 1.96
"""Sds on each side of a normal 95 % interval."""
LABEL = 12
"""Pixels that a label needs."""


@dataclass(frozen=True, eq=False)
class Change:
    """Parameters of one unit: their changes and sds (n,) in that unit, NaN where unknown."""

    unit: str
    names: Sequence[str]
    changes: Array
    sds: Array


def changes(groups: Sequence[Change]) -> Figure | None:
    """A panel for each unit, a line for each parameter; None without any."""
    groups = [g for g in groups if len(g.names)]
    if not groups:
        return None
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    # Plotly places panels by shares of the width of the figure; gaps are left for their labels.
    width = 1.0 / len(groups)
    for i, group in enumerate(groups):
        end = suffix(i)
        domain = [i * width + (0.06 if i else 0.0), (i + 1) * width - 0.04]
        title = f"change [{shown_text(group.unit)}]"
        more[f"xaxis{end}"] = axis(title, domain=domain, zeroline=True, anchor=f"y{end}")
        more[f"yaxis{end}"] = axis(
            "", type="category", autorange="reversed", tickmode="linear", anchor=f"x{end}"
        )
        look = {"error_x": interval(WIDE * group.sds), "marker": {"color": AFTER, "size": 6}}
        axes = {"xaxis": f"x{end}", "yaxis": f"y{end}"}
        labels = names(group.names)
        data.append(trace("markers", group.unit, group.changes, labels, **look, **axes))
    most = max(len(g.names) for g in groups)
    sure = sum(int((np.abs(g.changes) > WIDE * g.sds).sum()) for g in groups)
    count = sum(len(g.names) for g in groups)
    return Figure(
        "parameters",
        "Changes of the parameters from their nominal values",
        "Bars are 95 % intervals. A bar that reaches zero: the data do not show a change. A bar "
        "much longer than the others: a weakly determined parameter.",
        f"Changes of {count} parameters with 95 % intervals; {sure} intervals exclude zero.",
        tuple(data),
        layout(120 + 20 * most, showlegend=False, **more),
    )


def correlations(covariance: Array, parameters: Sequence[str]) -> Figure | None:
    """A map of the correlations of a covariance (n, n), NaN where unknown; None below n = 2."""
    sds = np.sqrt(np.diag(covariance))
    if len(sds) < 2 or not np.isfinite(sds).any():
        return None
    scale = np.where(sds > 0.0, sds, np.nan)
    matrix = covariance / np.outer(scale, scale)
    apart = np.abs(np.where(np.eye(len(sds), dtype=bool), np.nan, matrix))
    strongest = "no two parameters have one."
    if np.isfinite(apart).any():
        i, j = divmod(int(np.nanargmax(apart)), len(sds))
        pair = f"{shown_text(parameters[i])} and {shown_text(parameters[j])}"
        strongest = f"the strongest is {matrix[i, j]:.3f} between {pair}."
    labels = names(parameters)
    ticks = {"tickmode": "linear", "type": "category", "tickfont": {"size": 9}}
    data = {
        "type": "heatmap",
        "x": labels,
        "y": labels,
        # hundredths: finer differences of a colour are invisible
        "z": [numbers(np.round(row, 2)) for row in matrix],
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#d55e00"], [0.5, "rgba(128,128,128,0.10)"], [1, "#0072b2"]],
        "colorbar": {"thickness": 10, "tickfont": {"size": 9}},
    }
    return Figure(
        "correlations",
        "Correlations of the estimated parameters",
        "Strong colour off the diagonal: these poses determine only the sum or difference of "
        "the two, so each alone is uncertain.",
        f"Map of the correlations of {len(sds)} parameters: {strongest}",
        (data,),
        layout(
            220 + LABEL * len(sds),
            xaxis=axis("", tickangle=-90, **ticks),
            yaxis=axis("", autorange="reversed", **ticks),
        ),
        least_width=160 + LABEL * len(sds),
    )
