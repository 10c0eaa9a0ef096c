"""How far the model is from the measured points, before and after: histogram and pose by pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    Figure,
    axis,
    colours,
    layout,
    names,
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
