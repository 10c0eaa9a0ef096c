"""What the readings can determine, before a fit: as `loopcal check --json` says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import offer, printed
from loopcal.companions.app.session import checked
from loopcal.companions.app.steps import GRADES
from loopcal.companions.app.view import View, heading, table
from loopcal.presentation.shown import in_unit, significant, unit_shown

CheckDocument = Mapping[str, Any]


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    offer(view, words.CHECK, lambda: ("check", view.project_name(), "--json"))
    run = view.session.last.get("check")
    before = view.session.state().runs.get("check")
    if view.session.outdated("check"):
        ui.label(words.OUTDATED).classes("care")
    elif run is None and before is not None:
        ui.label(words.CHECKED_EARLIER.format(at=before.at.replace("T", " ")[:16]))
    if run is None:
        return
    if (answer := checked(run)) is not None:
        _answer(answer)
    else:
        printed(view, "check")


def _answer(answer: CheckDocument) -> None:
    for warning in answer["warnings"]:
        ui.label(warning).classes("care")
    apart = [one["words"] for one in answer["identifiability"]["weak_directions"]]
    with ui.card().classes("w-full").props("flat bordered"):
        ui.label(answer["words"]).classes(f"text-subtitle1 {GRADES[answer['verdict']]}")
        for line in answer["said"]:
            if line not in apart:
                ui.label(line)
        if answer["remarks"]:
            with ui.expansion(words.REMARKS).classes("w-full"):
                for line in answer["remarks"]:
                    ui.label(line)
    if apart:
        heading(words.NOT_APART)
        for line in apart:
            ui.label(line)
    if answer["cure"] is not None:
        _cure(answer["cure"], {q["name"]: q["unit"] for q in answer["quantities"]})
    heading(words.EXPECTED)
    table(words.EXPECTED_HEAD, [_parameter(p) for p in answer["parameters"]])
    heading(words.RANGES)
    table(words.RANGE_HEAD, [_range(q) for q in answer["quantities"]])


def _cure(cure: CheckDocument, units: Mapping[str, str]) -> None:
    """The poses to measure besides."""
    heading(words.CURE)
    ui.label(cure["words"])
    poses: Sequence[CheckDocument] = cure["poses"]
    if cure["enough"] and poses:
        head = [f"{q} [{unit_shown(units[q])}]" for q in poses[0]]
        rows = [[f"{in_unit(v, units[q]):z.2f}" for q, v in pose.items()] for pose in poses]
        table(["no.", *head], [[str(i), *row] for i, row in enumerate(rows, 1)], pagination=10)
    ui.label(words.CURE_PLAN)


def _parameter(p: CheckDocument) -> list[str]:
    unit, prior_sd, sd = p["unit"], p["prior_sd"], p["expected_sd"]
    prior = "flat" if prior_sd is None else significant(in_unit(prior_sd, unit), 3)
    expected = "unknown" if sd is None else significant(in_unit(sd, unit), 3)
    sds = ["", "fixed"] if p["fixed"] else [prior, expected]
    shown = "" if unit == "1" else unit_shown(unit)
    return [p["name"], f"{round(in_unit(p['nominal'], unit), 9):z.6g}", *sds, shown, p["role"]]


def _range(q: CheckDocument) -> list[str]:
    ends = [
        "" if q[k] is None else f"{in_unit(q[k], q['unit']):z.6g}" for k in ("smallest", "largest")
    ]
    sd = "" if q["sd"] is None else significant(in_unit(q["sd"], q["unit"]), 3)
    return [q["name"], f"{q['readings']:,}", *ends, sd, unit_shown(q["unit"])]
