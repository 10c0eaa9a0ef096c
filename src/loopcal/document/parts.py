"""What a document holds beside a fit, and how it is judged: one explicit value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from loopcal.document.accuracy import Distances, ModelEntry, ValidationEntry
from loopcal.document.change_points import ChangePoints, Shifts
from loopcal.document.choice import Candidate, Chosen
from loopcal.document.findings import HalvesEntry, Outlier
from loopcal.document.fit import IntervalEntry


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What was stated, chosen, validated and compared beside a fit.

    title, inputs: of the project; about_readings, notes: warnings ahead of those of the fit, and
    behind them; errors: true minus estimated value [SI] of the parameters whose truth is known;
    method: as it was asked for, where the choice made another one of it; nominal, noise_floor: of
    the choice; culprits: what it says of robot, lens and board; halves: of the lens by two halves
    of the images; change_points, discarded: what it modelled, and the outliers that it left out;
    shifts: what it saw along the run where it modelled nothing;
    intervals: profile intervals by parameter; tolerance [SI], region: what the verdict judges;
    files: names of project and result, for command lines; None where there are no names.
    """

    title: str | None = None
    inputs: Mapping[str, Any] | None = None
    about_readings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    errors: Mapping[str, float] | None = None
    method: str | None = None
    chosen: Chosen | None = None
    culprits: tuple[Candidate, ...] = ()
    halves: tuple[HalvesEntry, ...] = ()
    nominal: Distances | None = None
    noise_floor: float | None = None
    change_points: ChangePoints | None = None
    discarded: tuple[Outlier, ...] = ()
    shifts: Shifts | None = None
    validation: ValidationEntry | None = None
    models: tuple[ModelEntry, ...] | None = None
    intervals: Mapping[str, IntervalEntry] = field(default_factory=dict)
    tolerance: float | None = None
    region: Mapping[str, tuple[float, float]] | None = None
    files: Mapping[str, str] | None = None
