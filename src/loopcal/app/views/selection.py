"""The poses selected in the linked figures: the ends of their run, and what is done with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import reason, written
from loopcal.app.place import Place
from loopcal.app.view import Part, heading, table
from loopcal.app.views.linked import Linked

LISTED = 200
"""Rows of the table of selected poses."""


def offer_selection(linked: Linked) -> None:
    """The panel."""
    heading(words.SELECTED_POSES)
    count_label = ui.label().classes("text-subtitle1")

    def count() -> None:
        chosen, every = linked.view.selected, len(linked.errors.size)
        some = words.SELECTED.format(count=len(chosen), all=every)
        count_label.set_text(some if chosen else words.NONE_SELECTED)

    _ends(linked)
    _zoom(linked)
    acts = Place(partial(_acts, linked))
    listed = Place(partial(_listed, linked))

    def of() -> object:
        return bool(linked.view.selected), linked.view.session.moved()

    linked.heard += [count, Part(of, acts.refresh).update]
    linked.later.append(listed.refresh)
    count()


def _chosen(linked: Linked) -> list[str]:
    """Ids of the selected poses."""
    poses = linked.errors.source.table.poses
    return [poses[i] for i in linked.view.selected]


def _run(linked: Linked) -> tuple[int, int] | None:
    """Positions of the ends of the selected run, of all poses where none is selected; None where
    the selection is no run."""
    chosen = linked.view.selected or range(len(linked.errors.size))
    first, last = chosen[0], chosen[-1]
    return (first, last) if last - first + 1 == len(chosen) else None


def _ends(linked: Linked) -> None:
    """The ends of the run by their ids, or moved by one pose: a finger is not as exact."""
    boxes: list[Any] = []
    buttons: list[Any] = []

    def poses() -> tuple[str, ...]:
        return linked.errors.source.table.poses

    def move(end: int, position: int) -> None:
        """Put one end there; the other one stays, as far as it can."""
        other = (_run(linked) or (0, len(poses()) - 1))[1 - end]
        if 0 <= position < len(poses()):
            ends = (
                (position, max(position, other)) if end == 0 else (min(position, other), position)
            )
            linked.select(range(ends[0], ends[1] + 1))

    def step(end: int, by: int) -> None:
        run = _run(linked)
        if run is not None:
            move(end, run[end] + by)

    def named(end: int, said: str) -> None:
        pose, run = said.strip(), _run(linked)
        if not pose or (run is not None and pose == poses()[run[end]]):
            return
        if pose in poses():
            move(end, poses().index(pose))
        else:
            ui.notify(words.NO_SUCH_POSE.format(pose=pose), type="negative")

    def show() -> None:
        run = _run(linked)
        for end, box in enumerate(boxes):
            box.set_value("" if run is None else poses()[run[end]])
        for button in buttons:
            button.set_enabled(run is not None)

    def stepper(end: int, by: int) -> None:
        icon, said = words.STEPPERS[by]
        button = ui.button(icon=icon, on_click=partial(step, end, by)).props("outline")
        buttons.append(button.props(f'aria-label="{words.ENDS[end]}: {said}"'))

    with ui.element("div").classes("ends"):
        for end, label in enumerate(words.ENDS):
            with ui.row().classes("items-center no-wrap q-gutter-x-xs"):
                stepper(end, -1)
                box = ui.input(label).classes("col").props("dense")
                boxes.append(written(box, partial(named, end)))
                stepper(end, +1)
    linked.heard.append(show)
    show()


def _zoom(linked: Linked) -> None:
    """What the figure over the poses shows in its whole width."""
    with ui.row().classes("q-gutter-xs"):
        near = ui.button(words.ZOOM_IN, icon="zoom_in").props("outline")
        near.on_click(lambda: linked.zoom(linked.view.selected))
        far = ui.button(words.ZOOM_OUT, icon="zoom_out").props("outline")
        far.on_click(lambda: linked.zoom([]))
        none = ui.button(words.SELECT_NONE, on_click=partial(linked.select, [])).props("outline")

    def show() -> None:
        for button in (near, none):
            button.set_enabled(bool(linked.view.selected))
        far.set_enabled(linked.span is not None)

    linked.heard.append(show)
    show()


def _acts(linked: Linked) -> None:
    """What can be done with the poses that are selected when it is asked for."""
    view = linked.view
    if not view.selected:
        return

    async def do(act: Callable[[Sequence[str], str], Any], kept: str) -> None:
        chosen, poses = list(view.selected), _chosen(linked)
        why = str(view.kept[kept] or words.REASONS[kept][0])
        linked.select([])
        if not await view.act_aside(partial(act, poses, why)):
            linked.select(chosen)

    reason(view, "shifted", words.REASONS["shifted"])
    for what, names in view.session.moved().items():
        act = partial(view.session.shifted, names)
        moved = ui.button(words.PARAMETERS_MOVED.format(what=what)).props("unelevated")
        moved.on_click(partial(do, act, "shifted"))
    reason(view, "excluded", words.REASONS["excluded"])
    exclude = partial(do, view.session.excluded, "excluded")
    ui.button(words.EXCLUDE, on_click=exclude).props("unelevated")


def _listed(linked: Linked) -> None:
    """The errors of the selected poses."""
    view, errors, poses = linked.view, linked.errors, _chosen(linked)
    if not poses:
        return
    rms = f"{errors.rms(view.selected):.3g} {errors.unit}"
    ui.label(words.RUN_RMS.format(first=poses[0], last=poses[-1], rms=rms))
    rows = [
        [p, *(f"{values[i]:.3g}" for values in errors.shown.values())]
        for p, i in zip(poses[:LISTED], view.selected, strict=False)
    ]
    table(["pose", *(f"{name} [{errors.unit}]" for name in errors.shown)], rows, pagination=10)
