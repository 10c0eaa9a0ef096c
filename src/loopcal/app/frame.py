"""The page: steps with their lights at the side, the step itself, and the run below it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import aclosing
from typing import Any

from nicegui import background_tasks, run, ui

from loopcal.app import words
from loopcal.app.pages import BY_KEY, Step, stand
from loopcal.app.place import Place
from loopcal.app.session import Session
from loopcal.app.shown_run import ShownRun
from loopcal.app.view import Part, View, title
from loopcal.errors import LoopcalError
from loopcal.presentation.wrapped import shortened

SCRIPTS = {"/linked.js": "linked.js", "/fields.js": "fields.js"}
"""Programs of the page, by their addresses."""
TIP = 'anchor="center right" self="center left"'
PATIENCE = 0.3
"""Seconds before a page says that it waits for files."""
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
.diagnose { display: grid; gap: 0.75rem 1rem; width: 100%; align-items: start;
  grid-template: "main parts" auto "rest parts" 1fr / minmax(0, 3fr) minmax(20rem, 1fr); }
.main { grid-area: main; } .parts { grid-area: parts; } .rest { grid-area: rest; }
.parts { display: grid; gap: 0 1.5rem;
         grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
.ends { display: grid; gap: 0.25rem 1rem; width: 100%;
        grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); }
@media (max-width: 1199px) {
  .diagnose { grid-template: "main" auto "parts" auto "rest" auto / minmax(0, 1fr); }
}
.columns { display: grid; gap: 0.5rem 1rem; width: 100%; align-items: center;
           grid-template-columns: fit-content(40%) minmax(7rem, 1fr) 5rem; }
.columns > * { min-width: 0; } .q-select .q-field__native > span { white-space: normal; }
.q-btn-group { flex-wrap: wrap; max-width: 100%; overflow-wrap: break-word; }
.q-btn-group > .q-btn { max-width: 100%; }
.tiles .linked { content-visibility: auto; contain-intrinsic-size: auto 300px; }
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
.q-table td { white-space: normal; overflow-wrap: break-word; }
.q-table td:first-child { overflow-wrap: anywhere; }
.step { min-height: 48px; width: 100%; justify-content: flex-start; text-transform: none; }
.q-btn { min-height: 44px; text-transform: none; }
.q-btn:focus-visible { outline: 3px solid #0072b2; outline-offset: 2px; }
@media (prefers-reduced-motion: reduce) {
  * { transition-duration: 0.01ms !important; animation-duration: 0.01ms !important;
      animation-iteration-count: 1 !important; }
}
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
    # In a thread: large files would keep all pages waiting.
    await run.io_bound(session.load)
    ui.add_css(STYLE)
    for address in SCRIPTS:
        ui.add_head_html(f'<script src="{address}"></script>')
    ui.colors(primary="#0b5cad")
    view = View(session)

    with ui.header(elevated=False).classes("items-center q-px-md"):
        menu_button = ui.button(icon="menu").props('flat color=white aria-label="Steps"')
        ui.label("loopcal").classes("text-h6")
        ui.label(str(session.folder.path.name)).classes("text-body2")
        ui.space()
        with ui.row().classes("items-center no-wrap") as waiting:
            ui.spinner(color="white")
            ui.label(words.READING)
        waiting.set_visibility(False)
        # None: as the browser prefers.
        ui.dark_mode(value=None)
    drawer = (
        ui.left_drawer(value=True).classes("q-pa-sm").props("width=200 breakpoint=700 bordered")
    )
    menu_button.on_click(drawer.toggle)

    def content() -> None:
        view.begin()
        shown = BY_KEY[view.step]
        title(shown.label, shown.words)
        _shown(view)

    def show(key: str) -> None:
        view.step = key
        session.news.tell()

    with drawer:
        lights = {step.key: _Light(step, show) for step in stand(session.state())}
    with ui.column().classes("w-full q-pa-md") as page:
        view.refresh = Place(content).refresh
    with ui.footer(elevated=True).classes("run") as foot:
        shown_run = ShownRun(session, foot)
    notice = _Notice(view)

    def light() -> None:
        for step in stand(session.state()):
            lights[step.key].show(step, chosen=step.key == view.step)

    light()
    lit = Part(lambda: (stand(session.state()), view.step), light)
    parts: list[Part | View | _Notice] = [view, lit, *shown_run.parts, notice]

    async def read() -> None:
        reading = asyncio.ensure_future(run.io_bound(session.load))
        if not (await asyncio.wait([reading], timeout=PATIENCE))[0]:
            waiting.set_visibility(True)
        await reading
        waiting.set_visibility(False)

    async def follow() -> None:
        async with aclosing(session.news.each()) as news:
            async for _ in news:
                with page:
                    if not session.ready:
                        await read()
                    for part in parts:
                        _update(part)

    following = background_tasks.create(follow())
    ui.context.client.on_delete(lambda: following.cancel())


def _update(part: Part | View | _Notice) -> None:
    """Draw a part anew, where it shows something else by now; a fault leaves the others."""
    try:
        part.update()
    except Exception:
        logging.getLogger(__name__).exception("a part of the page cannot be shown")


class _Notice:
    """Says that somebody else has changed the folder."""

    def __init__(self, view: View) -> None:
        self.view, self.finished = view, view.session.finished
        view.noticed = view.session.version

    def update(self) -> None:
        """Say so, where this page has neither changed it nor seen the run that did."""
        view, session = self.view, self.view.session
        version, finished = session.version, session.finished
        expected = session.going or finished != self.finished or view.acts
        if version != view.noticed and not expected:
            ui.notify(words.CHANGED)
        view.noticed, self.finished = version, finished


def _shown(view: View) -> None:
    """The step of a page; a fault in it leaves the other steps as they are."""
    try:
        BY_KEY[view.step].show(view)
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
        props = f'{look} aria-label="{step.label}: {said}" aria-current={current}'
        self.button.props(props, remove=other)
        self.icon.set_name(icon)
        self.icon.classes(replace=step.light)
        self.words.set_text(shortened(step.words))
