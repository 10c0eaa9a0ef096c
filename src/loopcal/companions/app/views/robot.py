"""The robot: its description, and the machine with a slider for each joint."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import uploader
from loopcal.companions.app.pictures import joints_of, machine_figure, moved
from loopcal.companions.app.scene import Scene
from loopcal.companions.app.session import read_robot
from loopcal.companions.app.view import View, plot, table
from loopcal.files.machines.meshes import READERS
from loopcal.files.machines.registry import drawn
from loopcal.files.project.project_file import Project
from loopcal.files.tables.registry import TEXT
from loopcal.mechanisms.parameters import Parameter
from loopcal.presentation.shown import in_unit, unit_shown

KINDS = {"urdf": "URDF", "dh": words.DH_TABLE, "machine": words.TYPE}
PARAMETER_HEAD = ("parameter", "nominal", "unit", "role")
MESHES = tuple(READERS)
NAMED = 4
"""Meshes that are named."""
ENDS = {"urdf": (".urdf", ".xml"), "dh": (*TEXT.endings, ".xlsx")}


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
    if project is not None or objection is not None:
        _remove(view)


def _choose(view: View) -> None:
    kind, value = view.session.robot()
    shown = str(view.kept.setdefault("robot.kind", kind or "urdf"))

    def of_kind(event: Any) -> None:
        view.keep("robot.kind", event.value)
        view.refresh()

    def of_value(event: Any) -> None:
        if event.value:
            view.act(lambda: view.session.choose_robot(shown, str(event.value)))

    ui.toggle(KINDS, value=shown, on_change=of_kind).props('no-caps aria-label="described by"')
    if shown == "machine":
        options = list(drawn())
    else:

        def chosen(name: str) -> None:
            if not name.lower().endswith(MESHES):  # they come along with a URDF
                view.session.choose_robot(shown, name)

        def check(path: Path) -> None:
            if path.suffix.lower() not in MESHES:
                read_robot(shown, path)

        uploader(view, words.DROP_ROBOT.format(kind=KINDS[shown]), chosen, check)
        options = view.files(ENDS[shown])
    selected = value if kind == shown and value in options else None
    box = ui.select(options, value=selected, label=KINDS[shown], on_change=of_value).classes("w-96")
    box.props(f'aria-label="{KINDS[shown]}"')
    if value:
        ui.label(words.ROBOT_DONE.format(name=value)).classes("good")
    else:
        ui.label(words.NO_ROBOT).classes("text-body2")


def _machine(view: View, project: Project) -> None:
    mechanism = project.mechanism
    ui.label(f"{mechanism.name}, stated in {view.project_name()}").classes("text-subtitle1")
    joints: dict[str, float] = view.kept.setdefault(f"robot.{view.project_name()}", {})
    for name in joints_of(mechanism):
        joints.setdefault(name, 0.0)
    scene = Scene(mechanism, view.session.links())
    figure = machine_figure(scene, joints)
    if figure is not None:
        with ui.element("div").classes("beside"):
            with ui.column().classes("figures"):
                drawn_robot = plot(figure, words.ROBOT_DRAWN)
            with ui.column().classes("acts"), ui.grid(columns="auto 1fr 5rem").classes("w-full"):

                def move(name: str, value: float) -> None:
                    joints[name] = value
                    drawn_robot.run_plot_method("restyle", *moved(scene, joints))

                for name in joints_of(mechanism):
                    unit = mechanism.quantities.get(name, "rad")
                    _slider(name, unit, joints[name], partial(move, name))
    if scene.links is not None and scene.links.absent:
        _absent(view, scene.links.absent)
    every = ((False, words.FREE), (True, words.FIXED))
    for fixed, said in every:
        some = [_row(p) for p in mechanism.parameters if p.fixed == fixed]
        if some:
            with ui.expansion(said.format(count=len(some))).classes("w-full why"):
                table(PARAMETER_HEAD, some)


def _absent(view: View, meshes: Sequence[str]) -> None:
    """Meshes that the URDF names and the folder does not have."""
    some = dict.fromkeys(meshes)
    listed = ", ".join([*some][:NAMED]) + (" ..." if len(some) > NAMED else "")
    ui.label(words.NO_MESHES.format(meshes=listed)).classes("text-body2")
    uploader(view, words.DROP_MESHES)


def _row(p: Parameter) -> list[str]:
    nominal = f"{in_unit(p.nominal, p.unit):.6g}"
    return [p.name, nominal, unit_shown(p.unit) if p.unit != "1" else "", p.role]


def _slider(name: str, unit: str, value: float, move: Any) -> None:
    # A step of most / 180 is 1 degree.
    most = np.pi if unit == "rad" else 1.0
    ui.label(name).classes("self-center")
    slider = ui.slider(min=-most, max=most, step=most / 180.0, value=value)
    slider.props(f'aria-label="{name} [{unit_shown(unit)}]"')
    value_label = ui.label().classes("self-center")

    def show(value: float) -> None:
        value_label.set_text(f"{in_unit(value, unit):z.1f} {unit_shown(unit)}")

    def at(event: Any) -> None:
        move(float(event.value))
        show(float(event.value))

    show(value)
    slider.on_value_change(at)


def _remove(view: View) -> None:
    """Begin anew with the same files."""
    ui.label(words.CHANGE_ROBOT).classes("text-body2 q-mt-md")
    remove = partial(view.act, partial(view.session.folder.remove, "another robot or other data"))
    ui.button(words.REMOVE_PROJECT, on_click=remove, icon="delete").props("outline color=negative")
