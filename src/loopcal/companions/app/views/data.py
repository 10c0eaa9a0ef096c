"""The readings: handed in, recognised, corrected by pointing."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.cells import bad_cells, columns
from loopcal.companions.app.controls import folded, offer, text, uploader
from loopcal.companions.app.pictures import joints_of, machine_figure, moved
from loopcal.companions.app.scene import Scene
from loopcal.companions.app.view import View, heading, plot, table
from loopcal.files.project.project_data import LoadedData
from loopcal.files.project.project_file import Project
from loopcal.files.tables.registry import BY_ENDING
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.outputs import Seen, seen_outputs
from loopcal.presentation.shown import in_unit, unit_shown

ENDS = tuple(BY_ENDING)
LENSES = (".json", ".yaml", ".yml")
"""Endings of the files that state cameras and boards."""
WRITTEN = ("readings.csv", "corners.csv")
"""Files that `loopcal init` may write beside the project."""
UNITS = {"rad": ("rad", "deg", "mrad"), "m": ("m", "mm", "cm", "um", "in"), "1": ("1",)}
POSE = """<q-td :props="props"><q-btn flat dense no-caps :label="props.value"
  @click="$parent.$emit('chosen', props.row)"></q-btn></q-td>"""
"""The pose of a row, which moves the robot there."""
PAGE = 12
"""Rows of a page of a table of readings, where it does not fit on two of them."""
ROWS = 2_000
"""Rows of readings shown; of more the first ones."""


def show(view: View) -> None:
    """The step."""
    uploader(view, words.DROP_READINGS)
    project = view.session.project()
    if project is None:
        objection = view.session.objection()
        if objection is not None:
            ui.label(objection).classes("bad printed")
        else:
            _recognise(view)
        return
    if project.data is None:
        _recognise(view)
        return
    _waiting(view, project)
    unread = view.session.unread()
    if unread:
        ui.label(unread).classes("bad printed")
        _bad(view, project)
    loaded = view.session.readings()
    scene = Scene(project.mechanism, view.session.links())
    with ui.element("div").classes("beside"):
        with ui.column().classes("figures"):
            drawn_robot = None if loaded is None else _robot(scene, project, loaded.dataset)
        with ui.column().classes("acts"):
            _columns(view, project)
    if loaded is not None:
        _rows(view, project, loaded, drawn_robot, scene)


def _waiting(view: View, project: Project) -> None:
    """Files that were handed in, and what becomes of them."""
    stated = project.inputs.get("data", {}).get("file")
    for name in view.session.waiting():
        with ui.element("section").classes("card care-edge"):
            ui.label(words.WAITING.format(name=name)).classes("care card-title")
            with ui.element("div").classes("deeds"):
                if isinstance(stated, str):
                    use = partial(view.session.changed, ["data", "file"], name, words.DROPPED)
                    label = words.USE_INSTEAD.format(name=stated)
                    ui.button(label, on_click=partial(view.act_aside, use)).props("unelevated")
                else:
                    ui.label(words.STATE_SOURCE)
                aside = partial(view.session.left_aside, name)
                ui.button(words.LEAVE_ASIDE, on_click=partial(view.act, aside)).props("outline")


def _recognise(view: View) -> None:
    kind, value = view.session.robot()
    files = [name for name in view.files((*ENDS, *LENSES)) if name != value]
    if not files:
        ui.label(words.NO_READINGS)
        return
    heading(words.FILES_READINGS)

    def keep(name: str, event: Any) -> None:
        view.keep(f"read.{name}", event.value)

    for name in files:
        chosen = view.kept.setdefault(f"read.{name}", True)
        ui.checkbox(name, value=chosen, on_change=partial(keep, name))
    robot = [f"--{kind}", str(value)] if kind and value else []
    if not robot:
        ui.label(words.ROBOT_FIRST).classes("care")
    links = [("base", words.BASE_LINK), ("tip", words.TIP_LINK)]
    options = [*(links if kind == "urdf" else []), ("sheet", words.PART_OF_FILE)]
    with folded(view, "read.stated", words.STATE_IT), ui.row():
        for option, label in options:
            text(view, f"read.{option}", label)

    # One to plan from, or readings named as the project's are: a copy of them is kept.
    replaces = view.session.project() is not None or {*WRITTEN} & {*files}
    replaced = ["--force"] if replaces else []

    def line() -> list[str]:
        names = [name for name in files if view.kept[f"read.{name}"]]
        stated = [(option, str(view.kept[f"read.{option}"] or "").strip()) for option, _ in options]
        more = [part for option, said in stated if said for part in (f"--{option}", said)]
        return ["init", *names, *robot, *more, "--out", ".", *replaced]

    offer(view, words.RECOGNISE, line, what=words.RECOGNISE_READINGS)


def _bad(view: View, project: Project) -> None:
    """The cells that are no numbers, where they stand."""
    cells = bad_cells(project)
    if not cells:
        return
    poses = list(dict.fromkeys(cell.pose for cell in cells))
    ui.label(words.BAD_CELLS.format(count=len(cells)))
    rows = [[c.file, str(c.row), c.pose, c.column, c.text] for c in cells]
    table(["file", "row", "pose", "column", "cell"], rows).classes("cells")
    exclude = partial(view.session.excluded, poses, "cells that are no numbers")
    label = words.EXCLUDE_BAD[len(poses) > 1].format(count=len(poses))
    ui.button(label, on_click=partial(view.act, exclude)).props("outline")


def _columns(view: View, project: Project) -> None:
    stated: dict[str, Any] = dict(project.inputs.get("data", {}).get("columns", {}))
    units = project.mechanism.units
    if not stated.keys() & units.keys():
        return  # every reading comes from files joined to the first one
    labels = columns(project)
    heading(words.COLUMNS_HEAD)
    ui.label(words.COLUMNS).classes("text-body2")
    with ui.element("div").classes("columns"):
        for name in ("quantity", "column of the file", "unit"):
            ui.label(name).classes("text-caption")
        for quantity, unit in units.items():
            entry = stated.get(quantity)
            if entry is not None:
                column = entry if isinstance(entry, dict) else {"column": entry}
                _column(view, quantity, unit, column, labels)


def _column(view: View, quantity: str, unit: str, entry: dict[str, Any], labels: list[str]) -> None:
    def change(key: str, event: Any) -> None:
        keys = ["data", "columns", quantity, key]
        view.act(partial(view.session.changed, keys, event.value, "corrected by pointing"))

    ui.label(quantity)
    now = entry.get("column", quantity)
    choices = {now: str(now) if now != 0 else "row number", **{name: name for name in labels}}
    box = ui.select(choices, value=now, on_change=partial(change, "column"))
    box.props(f'dense aria-label="column of {quantity}"')
    units = list(dict.fromkeys([str(entry.get("unit", unit)), *UNITS.get(unit, (unit,))]))
    box = ui.select(units, value=units[0], on_change=partial(change, "unit"))
    box.props(f'dense aria-label="unit of {quantity}"')


def _robot(scene: Scene, project: Project, data: Dataset) -> Any:
    """The machine in the first pose."""
    drawn = machine_figure(scene, _pose(project, data, 0)) if len(data) else None
    if drawn is None:
        return None
    return plot(drawn, words.ROBOT_IN_ROW)


def _pose(project: Project, data: Dataset, index: int) -> dict[str, float]:
    joints = dict.fromkeys(joints_of(project.mechanism), 0.0)
    # A quaternion says how a body is turned, and where a search begins where an unread one is.
    every = (*joints, *project.mechanism.pose_constants)
    return joints | {j: float(data[j][index]) for j in every if j in data.readings}


def _rows(view: View, project: Project, loaded: LoadedData, drawn_robot: Any, scene: Scene) -> None:
    data, mechanism = loaded.dataset, project.mechanism
    units = mechanism.units
    images = [one for one in seen_outputs(mechanism) if one.image]
    corners = {q for one in images for q in one.position}
    names = [name for name in data.readings if name in units and name not in corners]
    for warning in loaded.warnings:
        ui.label(str(warning)).classes("care")
    head = [{"name": "pose", "label": "pose", "field": "pose", "align": "left"}]
    head += [{"name": n, "label": _head(n, units[n]), "field": n, "align": "right"} for n in names]
    for one in images:
        counted = words.CORNERS_SEEN.format(camera=one.instrument)
        head.append(
            {"name": one.instrument, "label": counted, "field": one.instrument, "align": "right"}
        )
    rows = [
        _row(data, i, names, units) | {one.instrument: corners_read(data, i, one) for one in images}
        for i in range(min(len(data), ROWS))
    ]
    more = words.FIRST_ROWS.format(all=len(data), shown=ROWS)
    heading(more if len(data) > ROWS else f"{len(data):,} poses")

    def chosen(event: Any) -> None:
        if drawn_robot is not None:
            pose = _pose(project, data, int(event.args["index"]))
            drawn_robot.run_plot_method("restyle", *moved(scene, pose))

    made = ui.table(
        columns=head,
        rows=rows,
        row_key="index",
        pagination=PAGE if len(rows) > 2 * PAGE else 0,
    )
    hidden = "" if len(rows) > 2 * PAGE else "hide-pagination"
    made.props(f"dense flat {hidden}").classes("w-full").on("chosen", chosen)
    made.add_slot("body-cell-pose", POSE)
    made.add_slot(
        "body-cell",
        "<q-td :props=\"props\" :class=\"props.value === '' ? 'blank' : ''\">"
        "{{ props.value === '' ? 'blank' : props.value }}</q-td>",
    )
    left = project.inputs.get("data", {}).get("exclude", [])
    if left:
        with ui.row().classes("items-center"):
            ui.label(words.EXCLUDED.format(poses=", ".join(map(str, left))))
            use = partial(view.session.changed, ["data", "exclude"], None, words.USE_AGAIN)
            ui.button(words.USE_AGAIN, on_click=partial(view.act_aside, use)).props("outline")


def _head(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit_shown(unit)}]"


def _row(data: Dataset, i: int, names: list[str], units: Mapping[str, str]) -> dict[str, Any]:
    values = {n: float(data[n][i]) for n in names}
    shown = {n: "" if np.isnan(v) else f"{in_unit(v, units[n]):z.3f}" for n, v in values.items()}
    return {"index": i, "pose": data.poses[i], **shown}


def corners_read(data: Dataset, i: int, image: Seen) -> str:
    """How many corners of a pose's image are read, of all."""
    read = sum(np.isfinite(data[q][i]) for q in image.position if q in data.readings)
    return f"{read // 2} of {image.points}"
