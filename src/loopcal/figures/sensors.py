"""Corrections of the readings over their sds: against the normal curve, and over the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.figures.figure import (
    Array,
    Figure,
    axis,
    layout,
    names,
    numbers,
    panel_title,
    shown_text,
)
from loopcal.figures.thinning import POINTS, thinned

NORMAL = "#8d8f96"
"""Colour of the normal curve."""
COLUMNS = 3
"""Panels side by side."""


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
    rows = -(-len(usable) // COLUMNS)
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    titles = []
    for i, (name, values) in enumerate(usable.items()):
        row, column = divmod(i, COLUMNS)
        suffix = str(i + 1) if i else ""
        left, top = column / COLUMNS, 1.0 - row / rows
        right, bottom = left + 0.88 / COLUMNS, top - 0.72 / rows
        panel_axes = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
        quiet = {"showticklabels": False, "rangemode": "tozero", "title": {"text": ""}}
        more[f"xaxis{suffix}"] = axis("", domain=[left, right], anchor=f"y{suffix}", nticks=5)
        more[f"yaxis{suffix}"] = axis("", domain=[bottom, top], anchor=f"x{suffix}") | quiet
        counts = np.histogram(np.clip(values, -reach, reach), edges)[0]
        density = counts / (values.size * (edges[1] - edges[0]))
        normal = np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi)
        lines = [
            (0.5 * (edges[1:] + edges[:-1]), density, {"shape": "hvh", "width": 1.5}, "tozeroy"),
            (curve, normal, {"dash": "dot", "width": 2, "color": NORMAL}, "none"),
        ]
        for x, y, line, fill in lines:
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": shown_text(name),
                    "x": numbers(x),
                    "y": numbers(y),
                    "line": {"color": shades[name], **line},
                    "fill": fill,
                    "hoverinfo": "skip",
                    **panel_axes,
                }
            )
        rms = float(np.sqrt(np.square(values).mean()))
        titles.append(
            {
                "text": panel_title(name, f"rms {rms:.2f}"),
                "x": left,
                "y": top,
                "xref": "paper",
                "yref": "paper",
                "xanchor": "left",
                "yanchor": "bottom",
                "showarrow": False,
            }
        )
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
        suffix = "" if i == 0 else str(i + 1)
        top = 1.0 - i / count
        domain = [top - 0.88 / count, top]
        more[f"yaxis{suffix}"] = axis(
            panel_title(name, most=12), domain=domain, zeroline=True, nticks=4
        )
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": shown_text(name),
                "showlegend": False,
                "x": (chosen.index + 1).tolist(),
                "y": numbers(values[chosen.index]),
                "text": names([ids[j] for j in chosen.index]),
                "marker": {"color": shades[name], "size": 3},
                "yaxis": f"y{suffix}",
            }
        )
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
