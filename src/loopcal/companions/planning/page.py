"""The page of a plan: what it promises, the chosen poses in space, and the list of them."""

from __future__ import annotations

import numpy as np

from loopcal.companions.planning.planned import Plan
from loopcal.companions.robot.report_section import planned
from loopcal.figures.figure import Figure
from loopcal.figures.planning import Line, chosen_points, parameters_by_number
from loopcal.figures.space import Machine
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import measured_points, points
from loopcal.mechanisms.skeleton import skeleton, skeleton_labels
from loopcal.presentation.shown import SHOWN, Table, in_unit, significant, size, unit_shown
from loopcal.report.templates import Section, section_page
from loopcal.units import from_si


def plan_html(plan: Plan, title: str, mechanism: Mechanism, file: str) -> str:
    """The page; file: the project."""
    figures = (planned(plan.document()), _chosen(plan, mechanism), _parameters(plan))
    parts = (*figures, _poses(plan), _sds(plan))
    section = Section("plan", f"Plan: {title}", plan.summary(), parts)
    return section_page("plan", section, {"file": file, "poses": plan.count})


def _parameters(plan: Plan) -> Figure | None:
    groups: dict[str, list[Line]] = {}
    count = [p.poses for p in plan.curve]
    for name, unit in plan.units.items():
        sds = np.array([p.parameters[name] for p in plan.curve], dtype=float)
        shown = np.array([in_unit(v, unit, fine=True) for v in sds])
        groups.setdefault(unit_shown(unit, fine=True), []).append(Line(name, count, shown))
    return parameters_by_number(groups)


def _chosen(plan: Plan, mechanism: Mechanism) -> Figure | None:
    seen = next((names for names in measured_points(mechanism) if len(names) in (2, 3)), ())
    if not seen or any(q not in plan.closed.readings for q in seen):
        return None
    at = np.array([plan.closed.readings[q] for q in seen])
    family = next((f for f in mechanism.families if set(seen) <= set(f.readings)), None)
    at = at if family is None else points(family, at)
    readings = {q: float(v[0]) for q, v in plan.closed.readings.items()}
    try:
        lines = skeleton(mechanism, readings)
    except KeyError:
        # A joint that the plan does not state.
        lines = None
    machine = None if lines is None else Machine(lines, skeleton_labels(mechanism))
    return chosen_points(at, plan.use, plan.poses.poses, machine)


def _poses(plan: Plan) -> Table:
    units = {q: SHOWN.get(u, u) for q, u in plan.closed.units.items()}
    shown = {q: units.get(q, "") for q in plan.poses.readings}
    columns = {q: from_si(v, shown[q] or "1") for q, v in plan.poses.readings.items()}
    rows = [
        (str(i + 1), pose, plan.use[i], *(significant(float(v[i]), 6) for v in columns.values()))
        for i, pose in enumerate(plan.poses.poses)
    ]
    head = ("order", "pose", "use", *(f"{q} [{u}]" if u else q for q, u in shown.items()))
    return Table("The poses in the order to measure them", head, tuple(rows))


def _sds(plan: Plan) -> Table:
    rows = [
        (
            name,
            unit_shown(unit, fine=True),
            *("-" if v is None else size(v, unit, fine=True) for v in pair),
        )
        for name, unit in plan.units.items()
        for pair in [(plan.expected.parameters[name], plan.fitted.parameters[name])]
    ]
    head = ("parameter", "unit", "expected sd", "without the poses to validate")
    return Table("Expected sds of the parameters", head, tuple(rows))
