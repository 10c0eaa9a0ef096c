"""Which poses to measure: chosen, listed, drawn, and saved for the robot."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import choice, download, number, offer, page, pulses, text
from loopcal.app.pictures import end_points, joints_of, machine_figure, moved
from loopcal.app.view import View, heading, table
from loopcal.files.project.project_file import Project
from loopcal.files.project.project_folder import LOG, PLAN_DOCUMENT
from loopcal.mechanisms.limits import Limit, joint_limits
from loopcal.presentation.shown import in_unit, unit_shown, with_unit

OLD, ENDS = "", (".csv", ".tsv", ".txt", ".xlsx", ".parquet")


def show(view: View) -> None:
    """The step."""
    project = view.session.project()
    if project is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    files = [f.name for f in view.session.folder.listed() if "/" not in f.name]
    tables = {name: name for name in files if name.endswith(ENDS)}
    known = {OLD: "none"}
    if view.session.source() is not None:
        known[view.session.folder.result.name] = "those of the result"
    with ui.row().classes("items-end"):
        number(view, "plan.poses", words.POSES_TO_MEASURE, 30, min=1, max=1000, step=1)
        choice(view, "plan.criterion", words.BEST_FOR, words.CRITERIA)
        choice(view, "plan.existing", words.MEASURED_ALREADY, {**known, **tables})
        choice(view, "plan.candidates", words.CHOOSE_AMONG, {OLD: "random poses", **tables})
        choice(view, "plan.program", words.PROGRAM_POSES, words.PROGRAMS)
        text(view, "pulses", words.PULSES)
    _ranges(view, project)

    def line() -> Sequence[str]:
        kept = view.kept
        asked = ["plan", view.project_name(), "--poses", str(int(kept["plan.poses"] or 30))]
        for name in ("criterion", "existing", "candidates"):
            if kept[f"plan.{name}"]:
                asked += [f"--{name}", str(kept[f"plan.{name}"])]
        if kept["plan.program"]:
            program = f"{view.session.folder.plan.name}/plan{kept['plan.program']}"
            asked += ["--program", program, "--force", *pulses(view)]
        return asked

    offer(view, words.CHOOSE_POSES, line)
    _planned(view, project)
    view.anew_when(lambda: _follows_from(view))


def _follows_from(view: View) -> object:
    """What the step shows, but the ranges: these stay as they are being written."""
    session = view.session
    project = session.project()
    inputs = {} if project is None else {k: v for k, v in project.inputs.items() if k != "plan"}
    own = (LOG, session.folder.project.name)
    files = [(f.name, f.modified) for f in session.folder.listed() if f.name not in own]
    return files, inputs, project is None


def _ranges(view: View, project: Project) -> None:
    """[plan.ranges]: how far each joint may go, where limits of the machine do not say it."""
    joints = [q for q in joints_of(project.mechanism) if q in project.mechanism.quantities]
    stated: Mapping[str, Any] = project.inputs.get("plan", {}).get("ranges", {})
    limits = joint_limits(project.mechanism)
    known = all(q in limits or q in stated for q in joints)
    with ui.expansion(words.PLAN_RANGES, value=not known).classes("w-full"):
        ui.label(words.RANGES_HOW).classes("text-body2")
        with ui.grid(columns="auto 1fr 1fr auto").classes("items-center w-full max-w-xl"):
            for q in joints:
                _range(view, q, project.mechanism.quantities[q], stated.get(q), limits.get(q))


def _range(view: View, q: str, si: str, stated: Any, limit: Limit | None) -> None:
    """The ends of one joint, stated as soon as both are there."""
    unit = stated.get("unit", "1") if stated else unit_shown(si)
    before = (stated["from"], stated["to"]) if stated else (None, None)
    ends = () if limit is None else (limit.low, limit.high)
    shown = [f"{in_unit(v, si):z.4g}" for v in ends] if not stated else []
    ui.label(q)
    boxes = []
    for i, label in enumerate(words.RANGE_ENDS):
        box = ui.number(label, value=before[i]).props(f'aria-label="{q} {label}" dense')
        if shown:
            box.props(f'placeholder="{shown[i]}" stack-label')
        boxes.append(box)
    ui.label("" if unit == "1" else unit)

    def state() -> None:
        nonlocal before
        given = tuple(box.value for box in boxes)
        if given == before or (None in given) != (given == (None, None)):
            return
        before = low, high = given
        value = None if low is None else {"from": low, "to": high, "unit": unit}
        keys = ["plan", "ranges", q]
        view.act(lambda: view.session.changed(keys, value, words.PLAN_RANGES))

    for box in boxes:
        box.on("blur", state)
        box.on("keydown.enter", state)


def _planned(view: View, project: Project) -> None:
    folder = view.session.folder
    content = folder.content(f"{folder.plan.name}/{PLAN_DOCUMENT}")
    if content is None:
        return
    found: dict[str, Any] = json.loads(content)
    poses: list[dict[str, Any]] = found["poses"]
    heading(f"{len(poses)} poses")
    if found["expected"]:
        last = found["expected"][-1]
        told = [f"expected sd of the end point: {with_unit(last['end_point'], found['unit'])} rms"]
        told.append(f"largest {with_unit(last['largest'], found['unit'])}")
        ui.label(", ".join(told))
    with ui.row():
        download(f"{folder.plan.name}/plan.csv", words.DOWNLOAD.format(name="plan.csv"))
        page(f"{folder.plan.name}/plan.html", words.OPEN_PAGE_PLAN)
        for name in folder.inside_of(folder.plan.name):
            if name.endswith(tuple(filter(None, words.PROGRAMS))):
                download(f"{folder.plan.name}/{name}", words.DOWNLOAD.format(name=name))
    _drawn(project, [pose["readings"] for pose in poses])
    units = {**project.mechanism.quantities, **project.mechanism.known}
    names = [name for name in poses[0]["readings"] if name in units] if poses else []
    head = ["no.", "pose", "use", *(f"{n} [{unit_shown(units[n])}]" for n in names)]
    rows = [
        [str(i), str(pose["pose"]), str(pose["use"])]
        + [f"{in_unit(pose['readings'][n], units[n]):z.3f}" for n in names]
        for i, pose in enumerate(poses, 1)
    ]
    table(head, rows)


def _drawn(project: Project, poses: Sequence[dict[str, float]]) -> None:
    """The machine, moved through the plan by a slider."""
    mechanism = project.mechanism
    if not poses:
        return
    drawn = machine_figure(mechanism, poses[0], end_points(mechanism, poses))
    if drawn is None:
        return
    ui.label(words.PLANNED).classes("text-body2")
    plot = ui.plotly(drawn).classes("w-full").props('aria-label="the robot in the planned poses"')
    with ui.row().classes("items-center w-full no-wrap"):
        told = ui.label("pose 1").classes("w-24")

        def at(event: Any) -> None:
            number = int(event.value)
            told.set_text(f"pose {number}")
            plot.run_plot_method("restyle", moved(mechanism, poses[number - 1]), [0])

        slider = ui.slider(min=1, max=len(poses), step=1, value=1, on_change=at)
        slider.props('aria-label="planned pose"').classes("col")
