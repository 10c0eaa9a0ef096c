"""Pose performance as data sheets show it: bars, scatter around the commanded pose, drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLOURS,
    COLUMNS,
    Array,
    Bars,
    Figure,
    axis,
    bar_layout,
    colours,
    layout,
    panel_title,
    panels,
    trace,
)

SHADES = (BEFORE, AFTER, COLOURS[4])
"""Of AP, AP after fitting the base, and RP."""


def pose_bars(poses: Sequence[str], series: Sequence[Bars]) -> Figure:
    """AP before and after fitting the base, and RP, of every pose [mm]."""
    return Figure(
        "bars",
        "Accuracy and repeatability of every pose",
        "Lines show the 95 % interval. AP after fitting holds what no shift or turn of the base "
        "frame explains.",
        f"Bars of {', '.join(bars.name for bars in series)} for {len(poses)} poses.",
        tuple(bars.trace(poses) for bars in series),
        bar_layout(320, "mm"),
    )


def condition_bars(conditions: Sequence[str], series: Sequence[Bars]) -> Figure:
    """The largest AP before and after fitting the base, and RP, at every payload and speed [mm]."""
    return Figure(
        "conditions",
        "Accuracy and repeatability by condition",
        "The largest of all poses. Lines show the 95 % interval of that pose.",
        f"Bars of {', '.join(bars.name for bars in series)} at {len(conditions)} conditions.",
        tuple(bars.trace(conditions) for bars in series),
        bar_layout(320, "mm"),
    )


@dataclass(frozen=True, eq=False)
class Cloud:
    """Attained minus commanded positions (n, 3) [mm] of one pose; radius: its RP [mm]."""

    name: str
    offsets: Array
    radius: float | None


def scatter(clouds: Sequence[Cloud], plane: tuple[int, int] = (0, 1)) -> Figure:
    """A panel per pose: readings around the commanded pose, their mean, and the circle of RP."""
    letters = ["xyz"[k] for k in plane]
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    titles, shapes = [], []
    reach = max(
        max(float(np.ptp(c.offsets[:, k])) for k in plane) / 2.0 + (c.radius or 0.0) for c in clouds
    )
    every = panels(len(clouds))
    rows = every[0].rows
    for panel, cloud in zip(every, clouds, strict=True):
        suffix, left, top = panel.suffix, panel.left, panel.top
        at = cloud.offsets[:, plane]
        mean = at.mean(axis=0)
        more[f"xaxis{suffix}"] = axis(
            f"{letters[0]} [mm]",
            domain=[left + 0.02, left + 0.86 / COLUMNS],
            anchor=f"y{suffix}",
            range=[mean[0] - 1.15 * reach, mean[0] + 1.15 * reach],
            nticks=5,
        )
        more[f"yaxis{suffix}"] = axis(
            f"{letters[1]} [mm]",
            domain=[top - 0.78 / rows, top - 0.06 / rows],
            anchor=f"x{suffix}",
            range=[mean[1] - 1.15 * reach, mean[1] + 1.15 * reach],
            scaleanchor=f"x{suffix}",
            nticks=5,
        )
        # The commanded pose is drawn last, on top of the readings.
        for name, dots, look in (
            ("readings", at, {"color": COLOURS[0], "size": 5, "opacity": 0.6}),
            ("mean", mean[None], {"color": COLOURS[1], "size": 11, "symbol": "cross-thin-open"}),
            ("commanded", np.zeros((1, 2)), {"color": BEFORE, "size": 10, "symbol": "x-open"}),
        ):
            legend: dict[str, Any] = {"legendgroup": name, "showlegend": panel is every[0]}
            x, y = dots.T
            data.append(trace("markers", name, x, y, marker=look, **legend, **panel.axes))
        if cloud.radius is not None:
            shapes.append(
                {
                    "type": "circle",
                    "xref": panel.axes["xaxis"],
                    "yref": panel.axes["yaxis"],
                    **{f"x{e}": float(mean[0] + s * cloud.radius) for e, s in ((0, -1), (1, 1))},
                    **{f"y{e}": float(mean[1] + s * cloud.radius) for e, s in ((0, -1), (1, 1))},
                    "line": {"color": COLOURS[4], "width": 1.5},
                }
            )
        titles.append(panel.titled(panel_title(cloud.name), 0.02, 0.05 / rows))
    return Figure(
        f"scatter_{letters[0]}{letters[1]}",
        f"Readings around the commanded pose, {letters[0]} and {letters[1]}",
        "The circle around the mean has the radius RP; all panels have the same scale. The "
        "commanded pose is at 0, 0, outside of a panel whose AP is large beside RP.",
        f"Measured minus commanded {letters[0]} and {letters[1]} of {len(clouds)} poses.",
        tuple(data),
        layout(300 * rows + 40, annotations=titles, shapes=shapes, **more),
        least_width=720,
    )


@dataclass(frozen=True, eq=False)
class Course:
    """AP and RP [mm] of one pose over time, from block to block."""

    name: str
    times: Sequence[float]
    accuracy: Sequence[float]
    repeatability: Sequence[float]


def drift_courses(courses: Sequence[Course], unit: str) -> Figure | None:
    """AP (full lines) and RP (dotted) of every pose against time; None without any."""
    if not courses:
        return None
    shades = colours([course.name for course in courses])
    data = []
    for course in courses:
        for what, values, dash in (
            ("AP", course.accuracy, "solid"),
            ("RP", course.repeatability, "dot"),
        ):
            line = {"color": shades[course.name], "dash": dash, "width": 1.5}
            x, y = np.array(course.times), np.array(values)
            name = f"{what} {course.name}"
            data.append(trace("lines+markers", name, x, y, line=line, marker={"size": 5}))
    return Figure(
        "drift",
        "Drift of accuracy and repeatability",
        "AP of every block of cycles in full lines, RP in dotted ones. A level line is a robot "
        "that does not drift.",
        f"AP and RP of {len(courses)} poses against {unit}.",
        tuple(data),
        layout(340, xaxis=axis(unit), yaxis=axis("mm", rangemode="tozero")),
    )
