"""The readings: handed in, recognised, corrected by pointing."""

from __future__ import annotations

from typing import Any

import numpy as np
from nicegui import ui

from loopcal.app.pictures import machine_figure
from loopcal.app.uploads import uploader
from loopcal.app.view import View
from loopcal.files.project.project_data import LoadedData
from loopcal.files.project.project_file import Project
from loopcal.measurements.dataset import Dataset
from loopcal.presentation.shown import in_unit, unit_shown

ENDS = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".parquet", ".mat")
UNITS = {"rad": ("rad", "deg", "mrad"), "m": ("m", "mm", "cm", "um", "in"), "1": ("1",)}
ROWS = 2_000
"""Rows of readings shown; of more the first ones."""


def show(view: View) -> None:
    """The step."""
    uploader(view, "Drop the files of readings here")
    project = view.session.project()
    if project is None:
        _recognise(view)
        return
    told = view.session.unread()
    if told:
        ui.label(told).classes("bad printed")
    _columns(view, project)
    loaded = view.session.readings()
    if loaded is not None:
        _rows(project, loaded)


def _recognise(view: View) -> None:
    kind, value = view.session.robot()
    files = [
        f.name for f in view.session.folder.listed() if f.name.endswith(ENDS) and f.name != value
    ]
    chosen = set(files)
    if not files:
        ui.label("No file of readings is in the folder yet.")
        return

    def keep(name: str, wanted: bool) -> None:
        if wanted:
            chosen.add(name)
        else:
            chosen.discard(name)

    ui.label("Files of readings:")
    for name in files:
        ui.checkbox(name, value=True, on_change=lambda e, name=name: keep(name, e.value))
    if not (kind and value):
        ui.label("Describe the robot first.").classes("care")
        return

    async def recognise() -> None:
        names = [name for name in files if name in chosen]
        await view.run_to_end(
            "Recognise the readings", "init", *names, f"--{kind}", value, "--out", "."
        )

    ui.button("Recognise", on_click=recognise).props("unelevated")


def _columns(view: View, project: Project) -> None:
    stated: dict[str, Any] = dict(project.inputs.get("data", {}).get("columns", {}))
    own = {**project.mechanism.quantities, **project.mechanism.known}
    ui.label("Columns").classes("text-h6")
    with ui.grid(columns="auto 1fr 1fr").classes("items-center"):
        for name in ("quantity", "column of the file", "unit"):
            ui.label(name).classes("text-caption")
        for quantity, unit in own.items():
            entry = stated.get(quantity)
            if entry is None:
                continue
            table = entry if isinstance(entry, dict) else {"column": entry}
            _column(view, quantity, unit, table)


def _column(view: View, quantity: str, unit: str, table: dict[str, Any]) -> None:
    def change(key: str, value: Any) -> None:
        if value != table.get(key):
            keys = ["data", "columns", quantity, key]
            view.act(lambda: view.session.changed(keys, value, "corrected by pointing"))

    ui.label(quantity)
    column = ui.input(value=str(table.get("column", quantity))).props(
        f'dense aria-label="column of {quantity}"'
    )
    column.on("blur", lambda: change("column", column.value))
    options = list(dict.fromkeys([str(table.get("unit", unit)), *UNITS.get(unit, (unit,))]))
    box = ui.select(options, value=options[0], on_change=lambda e: change("unit", e.value))
    box.props(f'dense aria-label="unit of {quantity}"')


def _rows(project: Project, loaded: LoadedData) -> None:
    data = loaded.dataset
    mechanism = project.mechanism
    units = {**mechanism.quantities, **mechanism.known}
    names = [name for name in data.readings if name in units]
    for warning in loaded.warnings:
        ui.label(str(warning)).classes("care")
    head = [{"name": "pose", "label": "pose", "field": "pose", "align": "left"}]
    head += [
        {"name": n, "label": f"{n} [{unit_shown(units[n])}]", "field": n, "align": "right"}
        for n in names
    ]
    rows = [_row(data, i, names, units) for i in range(min(len(data), ROWS))]
    said = f"{len(data)} poses" + (f"; the first {ROWS} are shown" if len(data) > ROWS else "")
    ui.label(said).classes("text-subtitle1")
    joints = [step.joint for step in mechanism.chain if step.joint]
    drawn = None
    if joints:
        drawn = machine_figure(mechanism, {j: float(data[j][0]) for j in joints})
    plot = ui.plotly(drawn).classes("w-full") if drawn is not None else None

    def chosen(event: Any) -> None:
        if plot is None or not event.selection:
            return
        index = event.selection[0]["index"]
        again = machine_figure(mechanism, {j: float(data[j][index]) for j in joints})
        if again is not None:
            plot.update_figure(again)

    made = ui.table(
        columns=head,
        rows=rows,
        row_key="index",
        selection="single",
        on_select=chosen,
        pagination=12,
    )
    made.props("dense flat").classes("w-full")


def _row(data: Dataset, i: int, names: list[str], units: dict[str, str]) -> dict[str, Any]:
    values = {n: float(data[n][i]) for n in names}
    shown = {n: "" if np.isnan(v) else f"{in_unit(v, units[n]):z.4f}" for n, v in values.items()}
    return {"index": i, "pose": data.poses[i], **shown}
