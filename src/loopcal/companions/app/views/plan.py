"""Which poses to measure: chosen, listed, drawn, and saved for the robot."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import (
    as_number,
    choice,
    download,
    folded,
    number,
    offer,
    page,
    pulses,
    pulses_field,
    written,
)
from loopcal.companions.app.pictures import end_points, joints_of, machine_figure, moved
from loopcal.companions.app.project_folder import PLAN_DOCUMENT
from loopcal.companions.app.scene import Scene
from loopcal.companions.app.view import View, heading, plot, table
from loopcal.companions.robot.programs.registry import WRITTEN
from loopcal.files.project.project_file import Project
from loopcal.files.tables.registry import BY_ENDING
from loopcal.mechanisms.limits import Limit, joint_limits
from loopcal.presentation.shown import in_unit, unit_shown, with_unit
from loopcal.units import to_si

OLD, ENDS = "", tuple(BY_ENDING)
APPROACHED = 0.02
"""A planned pose is measured where each joint was read so near [rad or m]: controllers stop nearer,
and poses of a plan lie farther apart."""


def show(view: View) -> None:
    """The step."""
    project = view.session.project()
    if project is None:
        _begin(view)
        return
    if (project.mechanism.description or {}).get("read") is False:
        ui.label(words.NOTHING_TO_PLAN)
        return
    tables = {name: name for name in view.files(ENDS)}
    measured = {OLD: "none"}
    if view.session.source() is not None:
        measured[view.result_name()] = "those of the result"
    with ui.row().classes("items-end"):
        number(view, "plan.poses", words.POSES_TO_MEASURE, 30, min=1, max=1000, step=1)
        choice(view, "plan.criterion", words.BEST_FOR, words.CRITERIA)
        choice(view, "plan.existing", words.MEASURED_ALREADY, {**measured, **tables})
        choice(view, "plan.candidates", words.CHOOSE_AMONG, {OLD: "random poses", **tables})
        programs = {ending: one.kind for ending, one in WRITTEN.items()}
        choice(view, "plan.program", words.PROGRAM_POSES, {"": words.NO_PROGRAM, **programs})
        pulses_field(view, "plan.program")
    _ranges(view, project)

    def line() -> Sequence[str]:
        kept = view.kept
        asked = ["plan", view.project_name(), "--poses", str(int(kept["plan.poses"] or 30))]
        for name in ("criterion", "existing", "candidates"):
            if kept[f"plan.{name}"]:
                asked += [f"--{name}", str(kept[f"plan.{name}"])]
        if kept["plan.program"]:
            program = f"{view.plan_name()}/plan{kept['plan.program']}"
            asked += ["--program", program, "--force", *pulses(view)]
        return asked

    offer(view, words.CHOOSE_POSES, line)
    _planned(view, project)


def _begin(view: View) -> None:
    """Before anything is measured: a project of the robot alone."""
    kind, value = view.session.robot()
    objection = view.session.objection()
    if objection is not None or not (kind and value):
        ui.label(objection or words.NO_PROJECT).classes("printed")
        return
    ui.label(words.PLAN_FIRST)
    line = ("init", f"--{kind}", str(value), "--out", ".")
    offer(view, words.PLAN_FROM.format(name=value), lambda: line)


def _ranges(view: View, project: Project) -> None:
    """[plan.ranges]: how far each joint may go, where limits of the machine do not say it."""
    joints = [q for q in joints_of(project.mechanism) if q in project.mechanism.quantities]
    stated: Mapping[str, Any] = project.inputs.get("plan", {}).get("ranges", {})
    limits = joint_limits(project.mechanism)
    with folded(view, "plan.ranges", words.PLAN_RANGES, opened=not limits.keys() >= {*joints}):
        ui.label(words.RANGES_HOW).classes("text-body2")
        with ui.grid(columns="auto 1fr 1fr auto").classes("items-center w-full max-w-xl"):
            for q in joints:
                _range(view, q, project.mechanism.quantities[q], stated.get(q), limits.get(q))


def _range(view: View, q: str, si: str, stated: Any, limit: Limit | None) -> None:
    """The ends of one joint, stated as soon as both are there."""
    unit = stated.get("unit", "1") if stated else unit_shown(si)
    before = (stated["from"], stated["to"]) if stated else (None, None)
    # Another stated range is another draft: half of an old one must not return.
    draft = f"plan.range.{q}.{before}"
    range_ends = view.kept.setdefault(draft, list(before))
    ends = () if limit is None else (limit.low, limit.high)
    shown = [f"{in_unit(v, si):z.4g}" for v in ends] if not stated else []
    ui.label(q)

    def state(end: int, said: str) -> None:
        range_ends[end] = as_number(said)
        low, high = range_ends
        if (low, high) == before or (low is None) != (high is None):
            return
        view.kept.pop(draft, None)
        value = None if low is None else {"from": low, "to": high, "unit": unit}
        keys = ["plan", "ranges", q]
        view.act(lambda: view.session.changed(keys, value, words.PLAN_RANGES))

    for i, label in enumerate(words.RANGE_ENDS):
        box = ui.number(label, value=range_ends[i]).props(f'aria-label="{q} {label}" dense')
        if shown:
            box.props(f'placeholder="{shown[i]}" stack-label')
        written(box, partial(state, i))
    ui.label("" if unit == "1" else unit)


def _planned(view: View, project: Project) -> None:
    folder = view.session.folder
    made = view.plan_name()
    content = folder.content(f"{made}/{PLAN_DOCUMENT}")
    if content is None:
        return
    if view.session.outdated("plan"):
        ui.label(words.OUTDATED).classes("care")
    document: dict[str, Any] = json.loads(content)
    poses: list[dict[str, Any]] = document["poses"]
    heading(f"{len(poses)} poses")
    if document["expected"]:
        last = document["expected"][-1]
        expectations = [
            f"expected sd of the end point: {with_unit(last['end_point'], document['unit'])} rms"
        ]
        expectations.append(f"largest {with_unit(last['largest'], document['unit'])}")
        ui.label(", ".join(expectations))
    with ui.row():
        download(f"{made}/plan.csv", words.DOWNLOAD.format(name="plan.csv"))
        page(f"{made}/plan.html", words.OPEN_PAGE_PLAN)
        for name in folder.inside_of(made):
            if name.endswith(tuple(WRITTEN)):
                download(f"{made}/{name}", words.DOWNLOAD.format(name=name))
    _measured(view, project, document)
    _drawn(view, project, [pose["readings"] for pose in poses])
    units = project.mechanism.units
    names = [name for name in poses[0]["readings"] if name in units] if poses else []
    head = ["no.", "pose", "use", *(f"{n} [{unit_shown(units[n])}]" for n in names)]
    rows = [
        [str(i), str(pose["pose"]), str(pose["use"])]
        + [f"{in_unit(pose['readings'][n], units[n]):z.3f}" for n in names]
        for i, pose in enumerate(poses, 1)
    ]
    table(head, rows)


def _measured(view: View, project: Project, document: Mapping[str, Any]) -> None:
    """While the file of readings grows: which planned pose is next, or whether they do."""
    data, poses = view.session.every_pose(), document["poses"]
    joints = joints_of(project.mechanism)
    if data is None or not poses or not {*joints} <= {*data.readings} & {*poses[0]["readings"]}:
        return
    read = np.column_stack([data[q] for q in joints])
    asked = np.array([[pose["readings"][q] for q in joints] for pose in poses])
    done = np.zeros(len(asked), dtype=bool)
    for i, at in enumerate(asked):  # a pose that is repeated needs as many readings
        near = np.flatnonzero(np.abs(read - at).max(axis=1) < APPROACHED)
        done[i] = len(near) > 0
        read = np.delete(read, near[:1], axis=0)
    heading(words.MEASURED.format(count=int(done.sum()), all=len(poses)))
    if done.all():
        demand = (project.inputs.get("verdict") or {}).get("tolerance")
        most = to_si(demand["value"], demand["unit"]) if isinstance(demand, dict) else np.inf
        sd = document["expected"][-1]["end_point"] if document["expected"] else None
        ui.label(words.STOP if sd is None or sd <= most else words.MORE_POSES)
        return
    pose = poses[int(np.argmin(done))]
    units = project.mechanism.quantities
    joint_words = ", ".join(
        f"{q} {in_unit(pose['readings'][q], units[q]):z.2f} {unit_shown(units[q])}" for q in joints
    )
    ui.label(words.NEXT_POSE.format(pose=pose["pose"], at=joint_words)).classes("text-subtitle1")


def _drawn(view: View, project: Project, poses: Sequence[dict[str, float]]) -> None:
    """The machine, moved through the plan by a slider."""
    mechanism = project.mechanism
    if not poses:
        return
    first = min(int(view.kept.get("plan.pose", 1)), len(poses))
    scene = Scene(mechanism, view.session.links())
    drawn = machine_figure(scene, poses[first - 1], end_points(mechanism, poses))
    if drawn is None:
        return
    ui.label(words.PLANNED).classes("text-body2")
    drawn_robot = plot(drawn, words.ROBOT_PLANNED)
    with ui.row().classes("items-center w-full no-wrap"):
        pose_label = ui.label(f"pose {first}").classes("w-24")

        def at(event: Any) -> None:
            number = int(event.value)
            view.keep("plan.pose", number)
            pose_label.set_text(f"pose {number}")
            drawn_robot.run_plot_method("restyle", *moved(scene, poses[number - 1]))

        slider = ui.slider(min=1, max=len(poses), step=1, value=first, on_change=at)
        slider.props('aria-label="planned pose"').classes("col")
