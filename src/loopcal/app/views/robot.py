"""The robot: its description, and the machine with a slider for each joint."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from loopcal.app.pictures import machine_figure
from loopcal.app.uploads import uploader
from loopcal.app.view import View, table
from loopcal.files.project.project_file import Project
from loopcal.presentation.shown import in_unit, unit_shown

TYPES = ("motoman-ma1400",)
"""Machines whose dimensions loopcal knows."""
KINDS = {"urdf": "URDF", "dh": "table of Denavit-Hartenberg parameters", "machine": "type"}


def show(view: View) -> None:
    """The step."""
    project = view.session.project()
    objection = view.session.objection()
    if objection is not None:
        ui.label(objection).classes("bad printed")
    if project is None:
        _choose(view)
    else:
        _machine(view, project)


def _choose(view: View) -> None:
    kind, value = view.session.robot()
    chosen = {"kind": kind or "urdf", "value": value}

    def keep() -> None:
        if chosen["value"]:
            view.act(lambda: view.session.choose_robot(str(chosen["kind"]), str(chosen["value"])))

    def of_kind(given: str) -> None:
        chosen.update(kind=given, value=None)
        named.refresh()

    def of_value(given: Any) -> None:
        chosen["value"] = given
        keep()

    @ui.refreshable
    def named() -> None:
        if chosen["kind"] == "machine":
            options = list(TYPES)
        else:
            ends = (".urdf", ".xml") if chosen["kind"] == "urdf" else (".csv", ".tsv", ".txt")
            options = [f.name for f in view.session.folder.listed() if f.name.endswith(ends)]
        known = chosen["value"] if chosen["value"] in options else None
        ui.select(
            options,
            value=known,
            label=KINDS[str(chosen["kind"])],
            on_change=lambda e: of_value(e.value),
        ).classes("w-80")

    with ui.row().classes("items-end"):
        ui.toggle(KINDS, value=chosen["kind"], on_change=lambda e: of_kind(e.value))
    named()
    uploader(view, "Hand in the file of the robot")
    if value:
        ui.label(f"The robot is described by {value}. Go on with the readings.").classes("good")


def _machine(view: View, project: Project) -> None:
    mechanism = project.mechanism
    ui.label(f"{mechanism.name}, stated in {view.project_name()}").classes("text-subtitle1")
    joints = {step.joint: 0.0 for step in mechanism.chain if step.joint}
    drawn = machine_figure(mechanism, joints) if joints else None
    if drawn is not None:
        plot = ui.plotly(drawn).classes("w-full")

        def moved(name: str, value: float) -> None:
            joints[name] = value
            again = machine_figure(mechanism, joints)
            if again is not None:
                plot.update_figure(again)

        with ui.grid(columns="auto 1fr auto").classes("w-full items-center"):
            for name in joints:
                _slider(name, mechanism.quantities.get(name, "rad"), partial(moved, name))
    rows = [
        [
            p.name,
            f"{in_unit(p.nominal, p.unit):.6g}",
            unit_shown(p.unit) if p.unit != "1" else "",
            mechanism.kinds[p.name],
        ]
        for p in mechanism.parameters
    ]
    table(["parameter", "nominal", "unit", "kind"], rows)


def _slider(name: str, unit: str, moved: Any) -> None:
    most = np.pi if unit == "rad" else 1.0
    ui.label(name)
    told: Any = None

    def at(event: Any) -> None:
        moved(float(event.value))
        if told is not None:
            told.set_text(f"{in_unit(float(event.value), unit):.1f} {unit_shown(unit)}")

    ui.slider(min=-most, max=most, step=most / 180.0, value=0.0, on_change=at).props(
        f'aria-label="{name}"'
    )
    told = ui.label(f"0 {unit_shown(unit)}").classes("w-20")
