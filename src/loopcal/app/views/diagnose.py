"""One selection of poses in all figures; what is found is left out, or taken as moved."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.pictures import Errors, Framed
from loopcal.app.view import Part, View, heading, stale, table
from loopcal.app.views.fit import offer_fit
from loopcal.app.views.linked import OVER_POSES, Linked, offer_selection
from loopcal.document.change_points import ChangePoints
from loopcal.report.tables import outlier_table


def show(view: View) -> None:
    """The step."""
    errors = _errors(view)
    if errors is None:
        none = view.session.unreadable() or words.NO_RESULT
        ui.label(none if view.session.source() is None else words.NO_OUTPUTS)
        return
    linked = Linked(view, errors)
    session = view.session

    def follow() -> None:
        now = _errors(view)
        if now is None or not linked.follow(now):
            view.refresh()

    def of() -> object:
        return session.shown(), linked.errors.steps if session.refits.going else _steps(view)

    view.anew_when(lambda: session.source() is None)
    view.parts.append(Part(of, follow))
    stale(view)
    view.part(session.shown, partial(_thinned, linked))
    with ui.element("div").classes("diagnose"):
        with ui.column().classes("main"):
            _over_poses(linked)
        with ui.element("div").classes("parts"):
            with ui.column():
                offer_selection(linked)
            with ui.column():
                _again(linked)
        with ui.column().classes("rest"):
            _elsewhere(linked)


def _errors(view: View) -> Errors | None:
    """Those of the result, or of the first fit since the project has changed."""
    source = view.session.shown()
    if source is None:
        return None
    view.select_among(source.table.poses)
    return Errors.of(source, _steps(view), view.selected)


def _steps(view: View) -> tuple[float, ...]:
    return tuple(view.session.steps())


def _thinned(linked: Linked) -> None:
    errors = linked.errors
    if len(errors.drawn) < len(errors.size):
        ui.label(words.NOT_WHOLE.format(shown=len(errors.drawn), all=len(errors.size)))


def _over_poses(linked: Linked) -> None:
    """The errors in the order of measurement; zoomed where the user has asked for it."""
    view = linked.view

    def other(event: Any) -> None:
        view.keep("diagnose.shown", event.value)
        linked.draw()

    shown = ui.toggle(list(linked.errors.shown), value=linked.what, on_change=other)
    shown.props('no-caps aria-label="error shown"')

    def of() -> Framed:
        return linked.errors.numbers, linked.errors.shown[linked.what]

    linked.plot(lambda e: linked.zoomed(e).over_poses(linked.what), OVER_POSES, of)


def _elsewhere(linked: Linked) -> None:
    """The errors in space, and over each joint."""
    if linked.errors.solid:
        ways = {False: words.DRAG_TURNS, True: words.DRAG_SELECTS}
        turn = ui.toggle(ways, value=False).props(f'no-caps aria-label="{words.DRAG}"')
        turn.on_value_change(lambda e: ui.run_javascript(f"linked.framing({str(e.value).lower()})"))
    linked.plot(lambda e: e.in_space(), "error in space")

    def of(name: str) -> Framed:
        return linked.errors.joint(name), linked.errors.shown[linked.what]

    with ui.element("div").classes("tiles"):
        for name in linked.errors.joints:
            # A default binds the name of this round; a closure would see that of the last one.
            def make(e: Errors, name: str = name) -> dict[str, Any]:
                return e.over_joint(name, linked.what)

            linked.plot(make, f"error over {name}", partial(of, name))


def _again(linked: Linked) -> None:
    """Undo, fit again, and what loopcal has found by itself."""
    view, session = linked.view, linked.view.session
    view.part(lambda: len(session.folder.log().entries), partial(_undo, view))
    heading(words.FIT_AGAIN)
    offer_fit(view)
    view.part(lambda: (session.source(), session.shown()), partial(_detected, linked))


def _undo(view: View) -> None:
    edits = view.session.folder.log().edits()
    if edits:
        label = words.UNDO.format(what=edits[-1].what[:60])
        undo = partial(view.act, view.session.folder.undo)
        ui.button(label, on_click=undo, icon="undo").props("outline")


def _detected(linked: Linked) -> None:
    """What loopcal has found by itself, with the poses to look at."""
    view, source = linked.view, linked.view.session.source()
    if source is None:
        return
    document = source.document
    changes = document.change_points
    points = () if changes is None else changes.found
    outliers = outlier_table(document)
    if not points and outliers is None:
        return
    heading(words.DETECTED_CHANGES)
    poses = linked.errors.source.table.poses
    for point in points:
        words_ = str(point)
        ui.label(f"{words_[0].upper()}{words_[1:]}.").classes("text-body2")
    _runs(linked, [poses.index(p.pose) for p in points if p.shape == "step" and p.pose in poses])
    if changes is not None and changes.toml:
        _state(view, changes)
    if outliers is not None:
        odd = [poses.index(str(row[0])) for row in outliers.rows if str(row[0]) in poses]
        ui.label(f"{outliers.caption}: pose {', '.join(str(row[0]) for row in outliers.rows[:12])}")
        if odd:
            ui.button(words.SELECT_THESE_POSES, on_click=partial(linked.select, odd)).props("flat")
        with ui.expansion(words.DETAILS).classes("w-full"):
            table(outliers.head, outliers.rows)


def _runs(linked: Linked, steps: Sequence[int]) -> None:
    """The runs of poses between positions where something has moved."""
    if not steps:
        return
    poses = linked.errors.source.table.poses
    with ui.row().classes("q-gutter-xs items-center"):
        ui.label(words.RUNS)
        for first, end in pairwise(sorted({0, *steps, len(poses)})):
            label = words.RUN.format(first=poses[first], last=poses[end - 1])
            select = partial(linked.select, range(first, end))
            ui.button(label, on_click=select).props("outline")


def _state(view: View, changes: ChangePoints) -> None:
    state = partial(view.session.modelled, changes, words.BY_LOOPCAL)
    button = ui.button(words.STATE_CHANGES, on_click=partial(view.act, state))
    button.props("outline")
