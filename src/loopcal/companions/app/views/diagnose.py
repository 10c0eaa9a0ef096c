"""The findings first; then one selection of poses in all figures, to exclude or take as moved."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.beside import left_out, without_changes, without_poses
from loopcal.companions.app.cards import begins
from loopcal.companions.app.controls import offer
from loopcal.companions.app.pictures import Errors, Framed
from loopcal.companions.app.view import Part, View, stale
from loopcal.companions.app.views.findings import offer_findings
from loopcal.companions.app.views.fit import fit_line
from loopcal.companions.app.views.linked import OVER_POSES, Linked, offer_selection

IN_SPACE = "error in space"
SLOW = "serial-dependence"
"""Code of the finding that errors depend on the order of the poses."""


def show(view: View) -> None:
    """The step."""
    errors = errors_of(view)
    if errors is None:
        none = view.session.unreadable() or words.NO_RESULT
        ui.label(none if view.session.source() is None else words.NO_OUTPUTS).classes(
            "printed-lines"
        )
        return
    linked = Linked(view, errors)
    session = view.session

    def follow() -> None:
        now = errors_of(view)
        if now is None or not linked.follow(now):
            view.refresh()

    def of() -> object:
        steps = linked.errors.steps if session.refits.going else _steps(view)
        return session.shown(), steps, session.left_out()

    def switch() -> None:
        now = errors_of(view)
        if now is not None:
            linked.follow(now)

    def judged() -> object:
        return session.source(), tuple(session.steps()), session.left_out()

    def findings() -> None:
        source = session.source()
        if source is not None:
            offer_findings(linked, source.document, switch)

    view.anew_when(lambda: session.source() is None)
    view.parts.append(Part(of, follow))
    stale(view)
    view.part(judged, findings)
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


def errors_of(view: View) -> Errors | None:
    """Those of the result, or of the first fit since the project has changed."""
    session = view.session
    source, judged = session.shown(), session.source()
    if source is None or judged is None:
        return None
    # Those left out since are grey at once, before a fit without them is done.
    source = without_poses(source, session.left_out())
    view.select_among(source.table.poses)
    before = without_changes(source) if view.kept.get("diagnose.before") else None
    # A first fit states no changes: those of the judged result stand until it is judged anew.
    points = () if judged.document.change_points is None else judged.document.change_points.found
    shown = [p for p in points if before is not None or not p.modelled]
    changed = begins(shown, judged.table.poses)
    stated = _steps(view)
    taken_up = begins([p for p in points if p not in shown], judged.table.poses)
    data = session.every_pose()
    return Errors.of(
        source,
        sorted({*stated, *taken_up}),
        view.selected,
        differences=before,
        changed={
            at: words.FROM_POSE.format(pose=p.pose)
            for at, p in changed.items()
            if before is not None or at not in stated
        },
        left_out=None if data is None else left_out(source, data),
        links=session.links(),
        slow=any(p.shape == "ramp" for p in points)
        or any(f.code == SLOW for f in judged.document.findings),
    )


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

    if len(linked.errors.shown) > 1:
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
    linked.plot(lambda e: e.in_space(linked.what), IN_SPACE)
    linked.later.append(partial(linked.pose, IN_SPACE))
    linked.pointed.append(partial(linked.pose, IN_SPACE))

    def of(name: str) -> Framed:
        return linked.errors.joint(name), linked.errors.shown[linked.what]

    with ui.element("div").classes("tiles"):
        for name in linked.errors.joints:
            # A default binds the name of this round; a closure would see that of the last one.
            def make(e: Errors, name: str = name) -> dict[str, Any]:
                return e.over_joint(name, linked.what)

            linked.plot(make, f"error over {name}", partial(of, name))


def _again(linked: Linked) -> None:
    """Undo, and fit again."""
    view, session = linked.view, linked.view.session
    view.part(lambda: len(session.folder.log().entries), partial(_undo, view))
    view.part(lambda: session.stale, partial(_fit_again, view))


def _fit_again(view: View) -> None:
    """Offered where the result is not of the project as it stands."""
    if view.session.stale:
        offer(view, words.FIT_AGAIN, lambda: fit_line(view), what=words.CALIBRATE)


def _undo(view: View) -> None:
    edits = view.session.folder.log().edits()
    if edits:
        label = words.UNDO.format(what=edits[-1].what[:60])
        undo = partial(view.act, view.session.folder.undo)
        ui.button(label, on_click=undo, icon="undo").props("outline")
