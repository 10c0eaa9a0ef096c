"""Which poses to measure: chosen, listed, drawn, and saved for the robot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import choice, download, number, offer, page, pulses, text
from loopcal.app.pictures import end_points, machine_figure, moved
from loopcal.app.view import View, heading, table
from loopcal.files.project.project_file import Project
from loopcal.files.project.project_folder import PLAN_DOCUMENT
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
