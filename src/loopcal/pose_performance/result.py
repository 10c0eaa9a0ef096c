"""Pose performance as one typed value [SI]."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from loopcal.document.plain import plain
from loopcal.pose_performance.parts import ConditionPerformance
from loopcal.pose_performance.summary import condition_lines, overview
from loopcal.presentation.text_table import columns

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
