"""The page: steps with their lights at the side, the step itself, and the run below it."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import background_tasks, run, ui

from loopcal.app import words
from loopcal.app.session import Session
from loopcal.app.steps import Step, steps
from loopcal.app.view import View, text_block, title
from loopcal.app.views import (
    check,
    data,
    deploy,
    diagnose,
    fit,
    history,
    plan,
    robot,
    validate,
)
from loopcal.errors import LoopcalError
from loopcal.presentation.wrapped import shortened

SHOWN: Mapping[str, Callable[[View], None]] = {
    "robot": robot.show,
    "data": data.show,
    "plan": plan.show,
    "check": check.show,
    "fit": fit.show,
    "diagnose": diagnose.show,
    "validate": validate.show,
    "deploy": deploy.show,
    "history": history.show,
}
LINKED = "/linked.js"
TIP = 'anchor="center right" self="center left"'
SAID = 1_500
"""Characters of what a failed run said that are shown at once; the end of it."""
LOOKS_EVERY, LISTENS_EVERY = 0.4, 0.1
"""Seconds between looks at the folder, and at the fit that goes on."""
STYLE = """
:root { --good: #17693a; --care: #8a4b00; --bad: #b3261e; --none: #525964; }
body.body--dark { --good: #6fdc9a; --care: #ffb95c; --bad: #ff9a90; --none: #a8b0bb; }
.js-plotly-plot svg text { fill: var(--none) !important; }
body .nicegui-code-copy { opacity: 1; inset: 0.15rem 0.25rem auto auto; }
body.body--light a.nicegui-link { color: #0b5cad; }
.good { color: var(--good) !important; } .care { color: var(--care) !important; }
.bad { color: var(--bad) !important; } .none { color: var(--none) !important; }
.printed { white-space: pre-wrap; font-family: ui-monospace, monospace; font-size: 0.8rem;
           overflow-wrap: anywhere; }
.beside { display: flex; flex-wrap: wrap; gap: 1rem; width: 100%; align-items: flex-start; }
.figures { flex: 3 1 420px; min-width: 0; } .acts { flex: 1 1 320px; min-width: 0; }
.diagnose { display: grid; gap: 0 1rem; width: 100%; align-items: start;
  grid-template: "main parts" auto "rest parts" 1fr / minmax(0, 3fr) minmax(20rem, 1fr); }
.main { grid-area: main; } .parts { grid-area: parts; } .rest { grid-area: rest; }
.parts { display: grid; gap: 0 1.5rem;
         grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
.ends { display: grid; gap: 0.25rem 1rem; width: 100%;
        grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); }
@media (max-width: 1199px) {
  .diagnose { grid-template: "main" auto "parts" auto "rest" auto / minmax(0, 1fr); }
}
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr));
         gap: 0.5rem; width: 100%; }
.file { display: inline-flex; align-items: center; gap: 0.4rem; min-height: 44px; }
.blank { background: #b3261e22; font-style: italic; } .cells td:last-child { color: var(--bad); }
.difference { border: 1px solid #8886; padding: 0.5rem; max-height: 420px; overflow: auto; }
.difference .gone { color: var(--bad); } .difference .come { color: var(--good); }
body .q-footer.run { color: inherit; max-height: 40vh; overflow: auto; padding: 0.4rem 1rem; }
body.body--light .q-footer.run { background: #f3f5f8; color: #1f2328; }
body.body--dark .q-footer.run { background: #24282e; color: #e6e6e6; }
body .tip { background: #333; color: #fff; font-size: 0.85rem; max-width: 22rem; }
.q-page { overflow-wrap: anywhere; } .q-checkbox { max-width: 100%; }
.q-uploader__list { min-height: 1.5rem; padding: 4px 8px; }
.linked :is(.selectionlayer, .outline-controllers) { display: none; }
.linked .select-outline { pointer-events: none !important; }
.linked .pane { position: absolute; z-index: 2; cursor: crosshair; touch-action: none; }
.linked .pane div { position: absolute; border: 2px dashed #d55e00; background: #d55e0022; }
.provisional { border-left: 4px solid var(--care); padding: 0.25rem 0.75rem; width: 100%; }
.command { max-width: 100%; } .command pre { padding-right: 2.5rem; white-space: pre-wrap; }
.q-table td { white-space: normal; overflow-wrap: anywhere; }
.step { min-height: 48px; width: 100%; justify-content: flex-start; text-transform: none; }
.q-btn { min-height: 44px; text-transform: none; }
.q-btn:focus-visible { outline: 3px solid #0072b2; outline-offset: 2px; }
@layer theme { /* of important rules the first layer wins */
  body.body--light .q-btn.step { color: #1f2328 !important; }
  body.body--dark .q-btn.step { color: #e6e6e6 !important; }
  body.body--dark .text-primary, body.body--dark a { color: #7db9ff !important; }
  body.body--dark .q-table__bottom .q-btn { color: inherit !important; }
  body.body--dark .text-negative { color: #ff9a90 !important; }
}
"""


async def build(session: Session) -> None:
    """One page on the folder."""
    await run.io_bound(session.load)
    ui.add_css(STYLE)
    ui.add_head_html(f'<script src="{LINKED}"></script>')
    ui.colors(primary="#0b5cad")
    view = View(session)
    known = _known(session)
    alive: list[Callable[[], Any]] = []

    with ui.header(elevated=False).classes("items-center q-px-md"):
        menu_button = ui.button(icon="menu").props('flat color=white aria-label="Steps"')
        ui.label("loopcal").classes("text-h6")
        ui.label(str(session.folder.path.name)).classes("text-body2")
        ui.space()
        with ui.row().classes("items-center no-wrap") as waiting:
            ui.spinner(color="white")
            ui.label(words.READING)
        waiting.set_visibility(False)
        ui.dark_mode(value=None)
    drawer = (
        ui.left_drawer(value=True).classes("q-pa-sm").props("width=200 breakpoint=700 bordered")
    )

    menu_button.on_click(drawer.toggle)

    @ui.refreshable
    def content() -> None:
        labels = {step.key: step.label for step in steps(session.state())}
        title(view, labels[view.step])
        _shown(view)

    @ui.refreshable
    def running() -> None:
        its = session.worker.run
        foot.set_value(its is not None or session.folder.log().unfinished() is not None)
        foot.props(f"data-finished={session.finished}")
        alive[:] = [_run(session)]

    async def draw_once_read() -> None:
        await run.io_bound(session.load)
        if not page.is_deleted:
            with page:
                waiting.set_visibility(False)
                draw()

    def draw() -> None:
        if not session.ready:
            if not waiting.visible:
                waiting.set_visibility(True)
                background_tasks.create(draw_once_read())
            return
        session.look_ahead()
        known.update(_known(session))
        for step in steps(session.state()):
            lights[step.key].show(step, chosen=step.key == view.step)
        if not view.follows():
            content.refresh()
        running.refresh()

    def show(key: str) -> None:
        view.step, view.follows = key, lambda: False
        draw()

    def look() -> None:
        if waiting.visible:
            return
        if session.version != known["version"]:
            now = _known(session)
            own = session.going or now["finished"] != known["finished"]
            draw()
            if not own:
                ui.notify(words.CHANGED)
        elif session.going:
            for follow in alive:
                follow()

    def listen() -> None:
        found = id(session.refits.found)
        if not waiting.visible and found != known["refit"]:
            if view.shows_refit:
                draw()
            known["refit"] = found

    view.refresh = draw
    with drawer:
        lights = {step.key: _Light(step, show) for step in steps(session.state())}
    with ui.column().classes("w-full q-pa-md") as page:
        content()
    with ui.footer(elevated=True).classes("run") as foot:
        running()
    lights[view.step].show(steps(session.state())[0], chosen=True)
    ui.timer(LOOKS_EVERY, look)
    ui.timer(LISTENS_EVERY, listen)


def _known(session: Session) -> dict[str, int]:
    """What a page has drawn."""
    refit = id(session.refits.found)
    return {"version": session.version, "finished": session.finished, "refit": refit}


def _shown(view: View) -> None:
    """The step of a page; a fault in it leaves the other steps as they are."""
    try:
        SHOWN[view.step](view)
    except LoopcalError as error:
        ui.label(str(error)).classes("bad printed")
    except Exception as error:
        logging.getLogger(__name__).exception("the step %s cannot be shown", view.step)
        ui.label(words.FAULT.format(fault=f"{type(error).__name__}: {error}")).classes("bad")


class _Light:
    """The button of a step. It stays where it is, so that neither a click nor the focus is lost
    where its light changes."""

    def __init__(self, step: Step, show: Callable[[str], Any]) -> None:
        self.button = ui.button(on_click=lambda: show(step.key)).classes("step")
        self.button.props("no-caps align=left")
        with self.button:
            self.icon = ui.icon("")
            ui.label(step.label).classes("q-ml-sm")
            self.words = ui.tooltip("").props(TIP).classes("tip")
        self.show(step, chosen=False)

    def show(self, step: Step, *, chosen: bool) -> None:
        """How the step stands now, and whether the page shows it."""
        icon, said = words.LIGHTS[step.light]
        look, other = ("outline", "flat") if chosen else ("flat", "outline")
        current = "step" if chosen else "false"
        told = f'{look} aria-label="{step.label}: {said}" aria-current={current}'
        self.button.props(told, remove=other)
        self.icon.set_name(icon)
        self.icon.classes(replace=step.light)
        self.words.set_text(shortened(step.words))


def _run(session: Session) -> Callable[[], Any]:
    """The run that goes on, or the last one; returns what shows its progress."""
    run = session.worker.run
    unfinished = session.folder.log().unfinished() if run is None else None
    if unfinished is not None:
        told = words.UNFINISHED.format(command=unfinished.told.get("command"))
        ui.label(told).classes("care")
    if run is None:
        return lambda: None
    progress = left = None
    with ui.row().classes("items-center w-full q-gutter-sm"):
        ui.label(run.action.what).classes("text-subtitle2")
        ui.code(run.action.command, language="bash").classes("text-caption gt-sm command")
        ui.space()
        if run.code is None:
            ui.spinner(size="sm")
            progress, left = ui.label(words.RUNNING), ui.label()
            ui.button(words.CANCEL, on_click=session.worker.cancel).props("outline")
        elif run.cancelled:
            ui.label(words.CANCELLED)
        elif run.code < 0:
            ui.label(words.KILLED).classes("bad")
        elif run.code == 0:
            ui.label(words.DONE).classes("good")
        else:
            ended = words.ENDED.format(code=run.code)
            ui.label(f"{ended}: {words.MEANING.get(run.code, '')}").classes("bad")
        if run.code is not None and run.text:
            with ui.dialog() as output, ui.card().classes("w-full").style("max-width: 70rem"):
                text_block(run.text)
                ui.button(words.CLOSE, on_click=output.close)
            ui.button(words.OUTPUT, on_click=output.open).props("flat")
    if run.code not in (None, 0) and not run.cancelled:
        text_block(run.text[max(run.text.rfind("loopcal: "), 0) :][-SAID:])

    def follow() -> None:
        if progress is not None and left is not None:
            progress.set_text(run.progress or words.RUNNING)
            seconds = seconds_left(run.progress, time.monotonic() - run.began)
            left.set_text("" if seconds is None else words.LEFT.format(seconds=seconds))

    return follow


def seconds_left(progress: str, passed: float) -> int | None:
    """Seconds that a run still takes, from a line such as "20 of 90 fits"; None where unknown.

    >>> seconds_left("30 of 90 fits", 10.0)
    20
    """
    found = re.search(r"(\d+) of (\d+)", progress)
    done, total = (int(part) for part in found.groups()) if found else (0, 0)
    return round(passed * (total - done) / done) if 0 < done <= total else None
