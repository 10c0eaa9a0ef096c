"""Corrections of the readings over their sds: against the normal curve, and over the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.figures.figure import (
    COLUMNS,
    Array,
    Figure,
    axis,
    layout,
    names,
    panel_title,
    panels,
    shown_text,
    suffix,
    trace,
)
from loopcal.figures.thinning import POINTS, thinned

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
