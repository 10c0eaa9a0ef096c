"""The page of pose performance: tables, bars, scatter of every pose and drift."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from loopcal.figures.figure import Bars, Figure
from loopcal.figures.pose_performance import (
    SHADES,
    Cloud,
    Course,
    condition_bars,
    drift_courses,
    pose_bars,
    scatter,
)
from loopcal.measurements.attained import AttainedPoses
from loopcal.pose_performance.intervals import Estimate
from loopcal.pose_performance.parts import ConditionPerformance
from loopcal.pose_performance.summary import (
    METHOD,
    Performance,
    Rows,
    headline,
    overview,
    tables_of,
)
from loopcal.presentation.shown import Table
from loopcal.report.section import Section
from loopcal.report.templates import page

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
    parts = [_bars(performance), first, *figures, *tables]
    return Section(f"c{number}", performance.name, words, parts)


def _table(title: str, rows: Rows) -> Table:
    return Table(title, rows[0], tuple(rows[1:]))


def _overview(conditions: Sequence[ConditionPerformance]) -> Section:
    """All payloads and speeds side by side; nothing for one condition."""
    rows = overview(conditions)
    if not rows:
        return Section("all", "", (), ())
    figures = zip(*(part.largest.figures for part in conditions), strict=True)
    drawn = condition_bars([part.name for part in conditions], _series(figures))
    return Section("all", "", (), (drawn, _table("Largest figures by condition", rows)))


def _bars(performance: ConditionPerformance) -> Figure:
    figures = (
        [pose.accuracy for pose in performance.poses],
        [pose.accuracy_fitted for pose in performance.poses],
        [pose.repeatability for pose in performance.poses],
    )
    return pose_bars([pose.name for pose in performance.poses], _series(figures))


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
    # All by time or all by number: one axis cannot hold both.
    timed = all(block.time is not None for drift in performance.drifts for block in drift.blocks)
    longest = max((b.time or 0.0 for d in performance.drifts for b in d.blocks), default=0.0)
    divisor, unit = (3600.0, "time [h]") if longest > 7200.0 else (60.0, "time [min]")
    courses = [
        Course(
            drift.pose,
            [
                float(number) if not timed else (block.time or 0.0) / divisor
                for number, block in enumerate(drift.blocks, 1)
            ],
            [MM * block.accuracy.value for block in drift.blocks],
            [MM * block.repeatability.value for block in drift.blocks],
        )
        for drift in performance.drifts[:MOST_PANELS]
    ]
    return drift_courses(courses, unit if timed else "block of cycles")
