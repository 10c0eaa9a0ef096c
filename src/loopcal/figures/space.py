"""Arrows at the measured points, from measured to computed, and the machine's skeleton."""

from __future__ import annotations

from typing import Any

import numpy as np

from loopcal.figures.figure import Array, Figure, axis, layout, numbers
from loopcal.figures.thinning import thinned
from loopcal.presentation.rounding import significant

ARROWS = 800
SHADES = ("#3b6fb5", "#2a9d8f", "#c9a227", "#e07b39", "#c8304b")
"""From the shortest to the longest arrows."""


def arrows(
    points: Array, differences: Array, skeleton: Array | None, unit: str, factor: float
) -> Figure | None:
    """Differences (d, N) [SI], computed minus measured, at measured points (d, N) [SI]; d = 2 or 3.

    skeleton: (k, d) joints of the machine in one pose; factor: SI in terms of `unit`, in which
    sizes are told. None where no pose has both.
    """
    sizes = np.sqrt(np.square(differences).sum(axis=0)) + 0.0 * points.sum(axis=0)
    chosen = thinned(sizes, ARROWS)
    if not chosen.index.size:
        return None
    at, along, size = points[:, chosen.index], differences[:, chosen.index], sizes[chosen.index]
    extent = float(np.linalg.norm(np.ptp(at, axis=1))) or 1.0
    scale = _round(0.08 * extent / max(float(np.percentile(size, 95)), 1e-15))
    edges = np.linspace(0.0, float(size.max()), len(SHADES) + 1)
    shade = np.clip(np.searchsorted(edges, size, side="left") - 1, 0, len(SHADES) - 1)
    data: list[dict[str, Any]] = []
    for i, colour in enumerate(SHADES):
        which = shade == i
        if which.any():
            lines = _lines(at[:, which], scale * along[:, which])
            name = f"up to {significant(float(edges[i + 1]) / factor, 2)} {unit}"
            data.append(_trace(lines, name, {"color": colour, "width": 2}))
    if skeleton is not None:
        trace = _trace(skeleton.T, "machine in one of the poses", {"color": "#8d8f96", "width": 5})
        data.append({**trace, "mode": "lines+markers", "marker": {"size": 5, "color": "#8d8f96"}})
    largest = significant(float(np.nanmax(sizes)) / factor, 3)
    times = f"{scale:,.0f}" if scale >= 1 else f"{scale:.3g}"
    return Figure(
        "arrows",
        "Where the calibrated model still differs",
        f"Arrows from measured to computed point, drawn {times} times as long as they are and "
        "coloured by size. Parallel neighbours indicate a missing effect in the model; arrows "
        f"in all directions are noise.{chosen.words}",
        f"{chosen.index.size} arrows at the measured points, {times} times enlarged; the largest "
        f"difference is {largest} {unit}.",
        tuple(data),
        _layout(len(points)),
    )


def _layout(dimensions: int) -> dict[str, Any]:
    if dimensions == 2:
        return layout(
            480, xaxis=axis("[m]"), yaxis=axis("[m]", scaleanchor="x", scaleratio=1), dragmode="pan"
        )
    scene = {f"{a}axis": {"title": {"text": f"{a} [m]"}} for a in "xyz"}
    camera = {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}
    return layout(560, scene={"aspectmode": "data", "camera": camera, **scene})


def _trace(coordinates: Array, name: str, line: dict[str, Any]) -> dict[str, Any]:
    keys = "xyz"[: len(coordinates)]
    return {
        "type": "scatter" if len(keys) == 2 else "scatter3d",
        "mode": "lines",
        "name": name,
        "line": line,
        "hoverinfo": "name",
        **{key: numbers(values) for key, values in zip(keys, coordinates, strict=True)},
    }


def _lines(start: Array, arrow: Array) -> Array:
    """Shafts and heads of arrows (d, n) as one broken line: NaN lifts the pen."""
    end = start + arrow
    flat = np.zeros_like(arrow)
    flat[0], flat[1] = -arrow[1], arrow[0]
    if len(arrow) == 3:
        # across the arrow: in the level plane, or along x where it stands upright
        upright = np.hypot(arrow[0], arrow[1]) < 0.1 * np.abs(arrow[2])
        flat[:, upright] = 0.0
        flat[0, upright] = arrow[2, upright]
    length = np.linalg.norm(flat, axis=0)
    across = flat * np.linalg.norm(arrow, axis=0) / np.where(length > 0.0, length, 1.0)
    left, right = end - 0.25 * arrow + 0.1 * across, end - 0.25 * arrow - 0.1 * across
    lifted = np.full_like(start, np.nan)
    drawn = np.stack([start, end, left, end, right, lifted], axis=2)
    return drawn.reshape(len(start), -1)


def _round(value: float) -> float:
    """The next number below of 1, 2, 5, 10, ..."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * 1.000001))
