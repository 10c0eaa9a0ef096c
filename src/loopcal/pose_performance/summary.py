"""Pose performance as printed: one table per kind of figure, in mm and degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from loopcal.document.plain import plain
from loopcal.pose_performance.intervals import Estimate
from loopcal.pose_performance.parts import ConditionPerformance
from loopcal.presentation.shown import NONE, columns, in_unit, percent, rounded_by_sd, unit_shown

Rows = Sequence[tuple[str, ...]]


def headline(part: ConditionPerformance) -> str:
    """The largest AP and RP of a condition in one sentence."""
    largest = part.largest
    accuracy, fitted, rough = largest.figures
    words = f"Largest AP {bounded(accuracy, 'm')} mm at {largest.accuracy.name}"
    if largest.fitted is not None:
        words += f", after fitting the base {bounded(fitted, 'm')} mm at {largest.fitted.name}"
    if largest.repeatability is not None:
        words += f". Largest RP {bounded(rough, 'm')} mm at {largest.repeatability.name}"
    return f"{words}. Brackets hold the 95 % interval."


def overview(parts: Sequence[ConditionPerformance]) -> Rows:
    """The largest figures at every payload and speed, as data sheets list them; none for one."""
    if len(parts) < 2:
        return []
    columns_of = list(parts[0].condition)
    head = (*columns_of, "poses", "largest AP [mm]", "AP fitted", "RP")
    return [head] + [
        (
            *(part.condition[key] for key in columns_of),
            str(len({pose.pose for pose in part.poses})),
            *(bounded(figure, "m") for figure in part.largest.figures),
        )
        for part in parts
    ]


def condition_lines(part: ConditionPerformance) -> Iterator[str]:
    """All figures of a condition, and what could not be computed."""
    if part.name:
        yield f"At {part.name}:"
    yield headline(part)
    for rows in tables_of(part).values():
        yield ""
        yield from columns(rows[: MOST_ROWS + 1])
        if len(rows) > MOST_ROWS + 1:
            yield f"(and {len(rows) - 1 - MOST_ROWS} more: --json has all)"
    for note in part.notes:
        yield ""
        yield note
    if part.missing:
        yield ""
        yield "Not computed:"
        yield from (f"  {line}" for line in part.missing)


NOTHING = 1e-6
"""Intervals of less [mm, deg] are rounding."""
MOST_ROWS = 60
"""Rows of a printed table."""


def tables_of(part: ConditionPerformance) -> dict[str, Rows]:
    """Title -> rows with their header, of each kind of figure that there is."""
    tables: dict[str, Rows] = {"Poses": _pose_rows(part)}
    if any(pose.orientation for pose in part.poses):
        unit = unit_shown("rad")
        head = (f"orientation [{unit}]", "axis", "AP", "AP fitted", "RP +-")
        tables["Orientation"] = [head] + [
            (
                pose.name,
                axis.axis,
                bounded(axis.accuracy, "rad"),
                bounded(axis.accuracy_fitted, "rad"),
                bounded(axis.repeatability, "rad"),
            )
            for pose in part.poses
            for axis in pose.orientation
        ]
    if part.variations:
        tables["Directions"] = [("variation [mm]", "directions", "vAP")] + [
            (v.pose, ", ".join(v.directions), bounded(v.variation, "m")) for v in part.variations
        ]
    if part.distances:
        tables["Distances"] = [("distance [mm]", "cycles", "commanded", "AD", "RD +-")] + [
            (
                " to ".join(d.poses),
                str(d.cycles),
                f"{in_unit(d.commanded, 'm'):.3f}",
                bounded(d.accuracy, "m"),
                bounded(d.repeatability, "m"),
            )
            for d in part.distances
        ]
    if part.drifts:
        tables["Drift"] = [("drift [mm]", "blocks", "shift", "dAP", "dRP")] + [
            (
                d.pose,
                str(len(d.blocks)),
                bounded(d.shift, "m"),
                bounded(d.accuracy, "m"),
                bounded(d.repeatability, "m"),
            )
            for d in part.drifts
        ]
    return tables


def _pose_rows(part: ConditionPerformance) -> Rows:
    rows = [("pose [mm]", "cycles", "AP", "AP fitted", "RP", "instrument's RP", "share")]
    for pose in part.poses:
        share = pose.instrument_share
        rows.append(
            (
                pose.name,
                str(pose.cycles),
                bounded(pose.accuracy, "m"),
                bounded(pose.accuracy_fitted, "m"),
                bounded(pose.repeatability, "m"),
                NONE if pose.instrument is None else f"{in_unit(pose.instrument, 'm'):.4f}",
                percent(None if share is None else min(share, 1.0)),
            )
        )
    if not any(pose.instrument is not None for pose in part.poses):
        return [row[:-2] for row in rows]
    return rows


def bounded(estimate: Estimate | None, unit: str) -> str:
    """A figure with its 95 % interval, in the unit shown, to the digits of that interval."""
    if estimate is None:
        return NONE
    value, low, high = (
        None if x is None else in_unit(x, unit)
        for x in (estimate.value, estimate.low, estimate.high)
    )
    assert value is not None
    if low is None or high is None:
        return f"{value:.4f}"
    # A 95 % interval is four sds wide.
    quarter = (high - low) / 4.0
    if not quarter > NOTHING:
        return f"{value:.4f}"
    shown = [rounded_by_sd(x, quarter) for x in (value, low, high)]
    return f"{shown[0]} [{shown[1]}, {shown[2]}]"


# Pose performance as one typed value [SI].

METHOD = "computed after ISO 9283, no conformity is claimed"


@dataclass(frozen=True)
class Performance:
    """Pose performance computed after ISO 9283, without any claim of conformity [SI].

    conditions: the figures at each payload and speed; notes: how the table was understood and what
    is not stated. `print` shows the figures, `document()` gives them as plain data.
    """

    file: str
    measurements: int
    conditions: tuple[ConditionPerformance, ...]
    notes: tuple[str, ...] = field(default_factory=tuple)

    def document(self) -> dict[str, Any]:
        """Plain data for JSON [m, rad, s]."""
        figures: dict[str, Any] = plain(self)
        return {"method": METHOD, "coverage": 0.95, **figures}

    def __str__(self) -> str:
        poses = len({pose.pose for part in self.conditions for pose in part.poses})
        lines = [
            f"Pose performance of {self.file}: {poses} poses, {self.measurements} measurements; "
            f"{METHOD}."
        ]
        if rows := overview(self.conditions):
            lines += ["", *columns(rows)]
        for part in self.conditions:
            lines += ["", *condition_lines(part)]
        if self.notes:
            lines += ["", *self.notes]
        return "\n".join(lines)
