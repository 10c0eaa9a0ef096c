"""The measured points in space with arrows to the computed ones, and the machine beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.figures.figure import Figure, axis, layout, names, spots, thinned
from loopcal.presentation.shown import significant

# More hide each other, and a browser turns them slowly.
ARROWS = 500
SHADES = ("#0072b2", "#56b4e9", "#c9b200", "#e69f00", "#b5340a")
"""From the shortest to the longest arrows."""
MACHINE = "#8d8f96"
FIELD = np.pi / 4.0
"""Field of view of plotly's camera, up and down."""
LABELS = 1.0
"""Room for the labels of the axes around their box."""


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine drawn in one pose: points (k, d) [m] of its lines, and a label of each or none."""

    points: Array
    labels: tuple[str, ...] = ()


def arrows(
    points: Array,
    stages: Mapping[str, Array],
    machine: Machine | None,
    ids: Sequence[str],
    unit: str,
    factor: float,
) -> Figure | None:
    """Arrows from measured to computed points, for each stage; the last one is shown first.

    points: (d, N) measured [SI], d = 2 or 3; stages: name -> differences (d, N) [SI], computed
    minus measured; ids: of the poses; factor: SI in terms of `unit`, in which sizes are stated.
    None where no pose has both.
    """
    sizes = {name: np.sqrt(np.square(d).sum(axis=0)) for name, d in stages.items()}
    last = list(stages)[-1]
    chosen = thinned(sizes[last] + 0.0 * points.sum(axis=0), ARROWS)
    if not chosen.index.size:
        return None
    at = points[:, chosen.index]
    drawn = {}
    enlargements = []
    for name, differences in stages.items():
        along, size = differences[:, chosen.index], sizes[name][chosen.index]
        labels = [
            f"pose {ids[i]}<br>{significant(s / factor, 3)} {unit}" if s == s else ""
            for i, s in zip(chosen.index, size, strict=True)
        ]
        scale = enlargement(at, size)
        drawn[name] = arrow_traces(at, scale * along, size / factor, labels, f"{unit} {name}")
        times = f"{scale:,.0f}" if scale >= 1 else f"{scale:.3g}"
        enlargements.append(f"{times} times {name}")
    data: list[dict[str, Any]] = []
    if machine is not None:
        data.append(machine_trace(machine))
    still = len(data)
    data += [{**t, "visible": n == last} for n, traces in drawn.items() for t in traces]
    largest = significant(float(np.nanmax(sizes[last])) / factor, 3)
    of = [name for name, traces in drawn.items() for _ in traces]
    return Figure(
        "arrows",
        "Where the model differs from what was measured",
        f"Arrows from measured to computed point, enlarged {', '.join(enlargements)}, coloured by "
        "size. Parallel neighbours indicate a missing effect in the model; arrows in all "
        f"directions are noise.{chosen.words}",
        f"{chosen.index.size} arrows at the measured points; the largest difference "
        f"{last} calibration is {largest} {unit}.",
        tuple(data),
        space_layout(data, _switch(list(stages), still, of)),
    )


def arrow_traces(
    at: Array, along: Array, size: Array, labels: Sequence[str], words: str
) -> list[dict[str, Any]]:
    """Arrows by shade, and a mark at each point that names its pose."""
    shade, ends = shaded(size)
    traces = []
    for i, colour in enumerate(SHADES):
        which = (shade == i) & np.isfinite(size)
        if which.any():
            lines = arrow_lines(at[:, which], along[:, which])
            name = f"up to {significant(ends[i], 2)} {words}"
            line = {"color": colour, "width": 2}
            traces.append(spots("lines", lines, name=name, line=line, hoverinfo="skip"))
    marks = {"color": [SHADES[i] for i in shade], "size": 2 if len(at) == 3 else 5}
    hover = {"text": names(labels), "hoverinfo": "text", "showlegend": False}
    return [*traces, spots("markers", at, name="pose", marker=marks, **hover)]


def shaded(size: Array) -> tuple[NDArray[np.intp], list[float]]:
    """(n,) the shade of each size, in steps up to the largest, and where each of them ends."""
    edges = np.linspace(0.0, float(np.nanmax(size)), len(SHADES) + 1)
    shade = np.clip(np.searchsorted(edges, size, side="left") - 1, 0, len(SHADES) - 1)
    return shade, edges[1:].tolist()


def machine_trace(machine: Machine) -> dict[str, Any]:
    """The machine in one pose."""
    mode = "lines+markers"
    hover: dict[str, Any] = {"hoverinfo": "name"}
    if machine.labels:
        mode += "+text"
        hover = {"text": names(machine.labels), "textposition": "top right", "hoverinfo": "text"}
    look = {"line": {"color": MACHINE, "width": 5}, "marker": {"size": 5, "color": MACHINE}}
    return spots(mode, machine.points.T, name="machine in one of the poses", **look, **hover)


def _switch(stages: Sequence[str], still: int, of: Sequence[str]) -> dict[str, Any]:
    """Buttons that show one stage at a time; of: the stage of each trace after the still ones."""
    if len(stages) < 2:
        return {}
    buttons = [
        {
            "label": f"{stage} calibration",
            "method": "restyle",
            "args": ["visible", [True] * still + [name == stage for name in of]],
        }
        for stage in stages
    ]
    return one_of(buttons, len(stages) - 1)


def one_of(buttons: Sequence[Mapping[str, Any]], active: int) -> dict[str, Any]:
    """Buttons in a row above the figure; active: the one whose traces are shown first."""
    menu = {"type": "buttons", "direction": "right", "buttons": buttons, "x": 0, "y": 1.0}
    place = {"xanchor": "left", "yanchor": "bottom", "active": active, "pad": {"b": 4}}
    # plotly marks the active button in white, also on a dark page
    return {"updatemenus": [{**menu, **place, "showactive": False}]}


def enlargement(at: Array, size: Array) -> float:
    extent = float(np.linalg.norm(np.ptp(at, axis=1))) or 1.0
    # The 95th percentile of the arrows becomes 8 % of the extent: visible, without overlap.
    value = 0.08 * extent / max(float(np.nanpercentile(size, 95)), 1e-15)
    # The next number below of 1, 2, 5, 10, ...
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * 1.000001))


def space_layout(
    data: Sequence[Mapping[str, Any]], more: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Two or three axes to scale; in space, all that the traces hold is in the picture."""
    more, dimensions = more or {}, 3 if "z" in data[0] else 2
    below = {"orientation": "h", "x": 0, "y": -0.02 if dimensions == 3 else -0.14, "yanchor": "top"}
    more = {**more, "margin": {"l": 8, "r": 8, "t": 48 if more else 16, "b": 8}, "legend": below}
    if dimensions == 2:
        plane = {"xaxis": axis("[m]"), "yaxis": axis("[m]", scaleanchor="x", scaleratio=1)}
        return layout(520, dragmode="pan", **plane) | more
    return layout(620, scene=_scene(data)) | more


def _scene(data: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Axes to scale around all traces."""
    drawn = np.hstack([np.array([trace[a] for a in "xyz"], dtype=float) for trace in data])
    return box_view(np.nanmin(drawn, axis=1), np.nanmax(drawn, axis=1))


def box_view(low: Array, high: Array) -> dict[str, Any]:
    """Axes to scale from low to high (3,), seen from where every corner of their box is in view.

    A corner c is in view of an eye at distance d along u where |right . c| and |up . c| are at most
    tan(fov / 2) (d - u . c).
    """
    margin = 0.05 * (float((high - low).max()) or 1.0)
    low, high = low - margin, high + margin
    box = (high - low) / (high - low).max()
    corners = 0.5 * box[:, None] * np.array(list(product((-1.0, 1.0), repeat=3))).T
    toward = np.array([1.0, 1.0, 0.45]) / np.linalg.norm([1.0, 1.0, 0.45])
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    aside = np.maximum(np.abs(right @ corners), np.abs(np.cross(toward, right) @ corners))
    distance = float((toward @ corners + LABELS * aside / np.tan(FIELD / 2.0)).max())
    axes = {
        f"{a}axis": {"title": {"text": f"{a} [m]"}, "range": [float(ends[0]), float(ends[1])]}
        for a, ends in zip("xyz", np.column_stack([low, high]), strict=True)
    }
    ratio = dict(zip("xyz", box.tolist(), strict=True))
    eye = dict(zip("xyz", (distance * toward).tolist(), strict=True))
    return {"aspectmode": "manual", "aspectratio": ratio, "camera": {"eye": eye}, **axes}


def arrow_lines(start: Array, arrow: Array) -> Array:
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
