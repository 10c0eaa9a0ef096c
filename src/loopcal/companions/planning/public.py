"""Planning in Python: paths wherever it takes values."""

from __future__ import annotations

from collections.abc import Mapping
from functools import wraps
from pathlib import Path
from typing import Any

from loopcal.companions.planning import plan as planning
from loopcal.companions.planning.plan_files import (
    PlanningBasis,
    basis_of,
    candidates_of,
    of_calibration,
    settings_of,
)
from loopcal.companions.planning.planned import Plan
from loopcal.estimation.result import FitResult
from loopcal.files.project.project_file import Project
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.workflow.readings import Units, readings
from loopcal.workflow.resolved import described
from loopcal.workflow.saved_result import SavedResult


@wraps(planning.plan)
def plan(
    mechanism: Any,
    poses: int = 30,
    *,
    candidates: Any = None,
    existing: Any = None,
    units: Units = None,
    **options: Any,
) -> Plan:
    """`plan`, of paths, projects and results too: a result is planned on from its poses."""
    if isinstance(mechanism, FitResult | SavedResult):
        mechanism, existing = mechanism.mechanism, mechanism if existing is None else existing
    description = described(mechanism)
    if isinstance(description, Project):
        basis = basis_of(description, existing)
        options.setdefault("settings", settings_of(description))
    elif (
        existing is None or isinstance(existing, Dataset | Mapping) or hasattr(existing, "columns")
    ):
        machine = getattr(description, "mechanism", description)
        data = None if existing is None else readings(existing, machine, units)
        basis = PlanningBasis(
            machine, options.pop("noise", getattr(description, "noise", None)), data
        )
    else:
        basis = of_calibration(existing)
    options.setdefault("noise", basis.noise)
    options["settings"] = basis.settled(options.get("settings") or PlanSettings())
    if candidates is not None:
        if isinstance(description, Project) and isinstance(candidates, str | Path):
            candidates = candidates_of(description, candidates)
        else:
            candidates = readings(candidates, basis.mechanism, units)
    return planning.plan(
        basis.mechanism, poses, candidates=candidates, existing=basis.existing, **options
    )
