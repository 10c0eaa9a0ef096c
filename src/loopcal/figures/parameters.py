"""The estimated parameters: changes with 95 % intervals, and a map of their correlations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.figures.figure import (
    AFTER,
    Array,
    Figure,
    axis,
    interval,
    layout,
    names,
    numbers,
    shown_text,
    suffix,
    trace,
)

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
