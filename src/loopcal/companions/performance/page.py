"""The page of pose performance: tables, bars, scatter of every pose and drift."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.performance.intervals import Estimate
from loopcal.companions.performance.parts import ConditionPerformance
from loopcal.companions.performance.summary import (
    METHOD,
    Performance,
    Rows,
    headline,
    overview,
    tables_of,
)
from loopcal.figures.figure import (
    AFTER,
    BEFORE,
    COLOURS,
    COLUMNS,
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
from loopcal.measurements.attained import AttainedPoses
from loopcal.presentation.shown import Table
from loopcal.report.templates import Section, page

# Pose performance as data sheets show it: bars, scatter around the commanded pose, drift.

SHADES = (BEFORE, AFTER, COLOURS[4])
"""Of AP, AP after fitting the base, and RP."""


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


MM = 1e3
MOST_PANELS = 30
"""Poses with a panel of their own; more are in the tables alone."""


def performance_html(done: Performance, attained: AttainedPoses) -> str:
    """One self-contained page; nothing in it is asked of any network."""
    return page(
        "performance.html",
        title=f"Pose performance of {done.file}",
        about={"file": done.file, "measurements": done.measurements},
        method=METHOD,
        overview=_overview(done.conditions),
        conditions=[
            {"section": _condition(c, attained, n), "missing": c.missing}
            for n, c in enumerate(done.conditions, 1)
        ],
        notes=done.notes,
    )


def _condition(performance: ConditionPerformance, attained: AttainedPoses, number: int) -> Section:
    first, *tables = (_table(title, rows) for title, rows in tables_of(performance).items())
    figures = [*_scatter(performance, attained), _drift(performance)]
    words = [headline(performance), *performance.notes]
    parts = [_bars_by_pose(performance), first, *figures, *tables]
    return Section(f"c{number}", performance.name, words, parts)


def _table(title: str, rows: Rows) -> Table:
    return Table(title, rows[0], tuple(rows[1:]))


def _overview(conditions: Sequence[ConditionPerformance]) -> Section:
    """All payloads and speeds side by side; nothing for one condition."""
    rows = overview(conditions)
    if not rows:
        return Section("all", "", (), ())
    drawn = _bars(
        "conditions",
        "Accuracy and repeatability by condition",
        "The largest of all poses. Lines show the 95 % interval of that pose.",
        "at {} conditions",
        [(part.name, *part.largest.figures) for part in conditions],
    )
    return Section("all", "", (), (drawn, _table("Largest figures by condition", rows)))


def _bars_by_pose(performance: ConditionPerformance) -> Figure:
    return _bars(
        "bars",
        "Accuracy and repeatability of every pose",
        "Lines show the 95 % interval. AP after fitting holds what no shift or turn of the base "
        "frame explains.",
        "for {} poses",
        [
            (pose.name, pose.accuracy, pose.accuracy_fitted, pose.repeatability)
            for pose in performance.poses
        ],
    )


Bar = tuple[str, Estimate | None, Estimate | None, Estimate | None]
"""A name with AP, AP after fitting the base, and RP."""


def _bars(key: str, title: str, caption: str, of: str, rows: Sequence[Bar]) -> Figure:
    """Bars of figures beside each other [mm]; of: what they are of, with room for a number."""
    named, *figures = zip(*rows, strict=True)
    series = _series(figures)
    label = f"Bars of {', '.join(bars.name for bars in series)} {of.format(len(rows))}."
    bars = tuple(bars.trace(named) for bars in series)
    return Figure(key, title, caption, label, bars, bar_layout(320, "mm"))


def _series(figures: Iterable[Sequence[Estimate | None]]) -> list[Bars]:
    """AP, AP after fitting the base, and RP, in mm."""
    kinds = ("AP", "AP after fitting the base", "RP")
    return [
        Bars(
            name,
            shade,
            [float("nan") if e is None else MM * e.value for e in estimates],
            [None if e is None or e.low is None else MM * e.low for e in estimates],
            [None if e is None or e.high is None else MM * e.high for e in estimates],
        )
        for name, shade, estimates in zip(kinds, SHADES, figures, strict=True)
    ]


def _scatter(performance: ConditionPerformance, attained: AttainedPoses) -> list[Figure]:
    offsets = MM * (attained.measured - attained.commanded)
    clouds = []
    for pose in performance.poses[:MOST_PANELS]:
        rows = [
            i
            for i in range(len(attained))
            if attained.pose[i] == pose.pose
            and (attained.direction is None or attained.direction[i] == pose.direction)
            and all(
                v[i] == performance.condition[k] for k, v in (attained.conditions or {}).items()
            )
        ]
        radius = None if pose.repeatability is None else MM * pose.repeatability.value
        clouds.append(Cloud(pose.name, offsets[rows], radius))
    return [scatter(clouds, plane) for plane in ((0, 1), (0, 2))[: 1 if attained.planar else 2]]


def _drift(performance: ConditionPerformance) -> Figure | None:
    """AP (full lines) and RP (dotted) of every pose against time; None without any."""
    # All by time or all by number: one axis cannot hold both.
    timed = all(block.time is not None for drift in performance.drifts for block in drift.blocks)
    longest = max((b.time or 0.0 for d in performance.drifts for b in d.blocks), default=0.0)
    divisor, unit = (3600.0, "time [h]") if longest > 7200.0 else (60.0, "time [min]")
    drifts = performance.drifts[:MOST_PANELS]
    if not drifts:
        return None
    shades = colours([drift.pose for drift in drifts])
    data = []
    for drift in drifts:
        numbers = [float(number) for number in range(1, len(drift.blocks) + 1)]
        times = [(block.time or 0.0) / divisor for block in drift.blocks] if timed else numbers
        for what, estimates, dash in (
            ("AP", [block.accuracy for block in drift.blocks], "solid"),
            ("RP", [block.repeatability for block in drift.blocks], "dot"),
        ):
            line = {"color": shades[drift.pose], "dash": dash, "width": 1.5}
            x, y = np.array(times), np.array([MM * one.value for one in estimates])
            name = f"{what} {drift.pose}"
            data.append(trace("lines+markers", name, x, y, line=line, marker={"size": 5}))
    label = unit if timed else "block of cycles"
    return Figure(
        "drift",
        "Drift of accuracy and repeatability",
        "AP of every block of cycles in full lines, RP in dotted ones. A level line is a robot "
        "that does not drift.",
        f"AP and RP of {len(drifts)} poses against {label}.",
        tuple(data),
        layout(340, xaxis=axis(label), yaxis=axis("mm", rangemode="tozero")),
    )
