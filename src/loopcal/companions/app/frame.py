"""The page: steps with their lights at the side, the step itself, and the run below it."""

from __future__ import annotations

import asyncio
import logging
import re
import shlex
import time
from collections.abc import Callable
from contextlib import aclosing
from pathlib import Path
from typing import Any

from nicegui import background_tasks, run, ui

from loopcal.companions.app import words
from loopcal.companions.app.addresses import Address
from loopcal.companions.app.pages import BY_KEY, Step, stand
from loopcal.companions.app.session import Session
from loopcal.companions.app.view import Part, Place, View, command, text_block, title
from loopcal.companions.app.worker import Run
from loopcal.errors import NEXT_COMMAND, LoopcalError
from loopcal.presentation.shown import shortened

SCRIPTS = {
    f"/{name}.js": f"{name}.js" for name in ("addresses", "fields", "presses", "linked", "tables")
}
"""Programs of the page, by their addresses."""
VERDICT = ("fit", "diagnose", "deploy")
"""Steps that begin with the verdict."""
PATIENCE = 0.3
"""Seconds before a page says that it waits for files."""
STYLE = Path(__file__).with_name("scripts") / "style.css"
CLOSED = "document.querySelector('.q-drawer__backdrop:not(.hidden)')?.click()"
"""Close the steps where they lie over the page, as on a phone."""


async def build(session: Session) -> None:
    """One page on the folder."""
    # In a thread: large files would keep all pages waiting.
    await run.io_bound(session.load)
    ui.add_css(STYLE)
    for address in SCRIPTS:
        ui.add_head_html(f'<script src="{address}"></script>')
    ui.colors(primary="#14515c")
    view = View(session, begins_at(session))
    view.run_script = ui.context.client.run_javascript
    request = ui.context.client.request
    view.go(Address.of(request.url.path, request.url.query, BY_KEY))

    with ui.header(elevated=False).classes("items-center head"):
        menu_button = ui.button(icon="menu").props('flat color=none aria-label="Steps"')
        ui.label(words.NAME).classes("mark")
        ui.label(str(session.folder.path.name)).classes("folder")
        ui.space()
        with ui.row().classes("items-center no-wrap") as waiting:
            ui.spinner()
            ui.label(words.READING)
        waiting.set_visibility(False)
        # None: as the browser prefers.
        ui.dark_mode(value=None)
    # Without a value it is open only where it leaves room for the page.
    drawer = ui.left_drawer().classes("q-pa-sm").props("width=176 breakpoint=700 bordered")
    drawer.props(f'role=navigation aria-label="{words.STEPS}"')
    menu_button.on_click(drawer.toggle)
    state = _State(view)

    def content() -> None:
        another = view.step != view.shown
        view.begin()
        shown = BY_KEY[view.step]
        title(shown.label, shown.words)
        state.draw()
        _shown(view)
        view.addressed(words.TITLE.format(step=shown.label, folder=session.folder.path.name))
        if another:
            ui.run_javascript("addresses.drawn()")

    def show(key: str) -> None:
        view.step, view.entry = key, None
        ui.run_javascript(f"addresses.show('/{key}', '', {view.went}); {CLOSED}")
        session.news.tell()

    def went(event: Any) -> None:
        said = event.args
        view.went = int(said["went"])
        view.go(Address.of(str(said["path"]), str(said["query"]), BY_KEY))
        view.refresh()
        session.news.tell()

    ui.on("went", went)
    with drawer:
        lights = {step.key: _Light(step, show) for step in stand(session.state())}
    with ui.column().classes("w-full q-pa-md") as page:
        view.refresh = Place(content).refresh
    with ui.footer(elevated=False).classes("run") as foot:
        shown_run = ShownRun(session, foot)
    notice = _Notice(view)

    def light() -> None:
        for step in stand(session.state()):
            lights[step.key].show(step, chosen=step.key == view.step)
        state.update()

    light()
    lit = Part(lambda: (stand(session.state()), view.step), light)
    parts: list[Part | View | _Notice] = [view, lit, *shown_run.parts, notice]

    async def read() -> None:
        reading = asyncio.ensure_future(run.io_bound(session.load))
        if not (await asyncio.wait([reading], timeout=PATIENCE))[0]:
            waiting.set_visibility(True)
        try:
            await reading
        except Exception:  # the steps say why, and hear of what is changed next
            logging.getLogger(__name__).exception("the folder cannot be read")
        finally:
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


def begins_at(session: Session) -> str:
    """The step at which the work on a folder goes on."""
    if session.source() is not None:
        return "fit"
    return "robot" if session.project() is None else "data"


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
        ui.label(error.text).classes("bad printed")
    except Exception as error:
        logging.getLogger(__name__).exception("the step %s cannot be shown", view.step)
        ui.label(words.FAULT.format(fault=f"{type(error).__name__}: {error}")).classes("bad")


class _State:
    """How the step of a page stands, in words below its title."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.icon: Any = None
        self.words: Any = None

    def draw(self) -> None:
        """Draw it where the page is being drawn, unless that begins with the verdict itself."""
        self.words = None
        if self.view.step in VERDICT and self.view.session.source() is not None:
            return
        with ui.element("div").classes("state"):
            self.icon, self.words = ui.icon(""), ui.label()
        self.update()

    def update(self) -> None:
        """Show the light as it is now."""
        if self.words is None or self.words.is_deleted:
            return
        now = next(s for s in stand(self.view.session.state()) if s.key == self.view.step)
        self.icon.set_name(words.LIGHTS[now.light][0])
        self.icon.props("aria-hidden=true").classes(replace=now.light)
        self.words.set_text(shortened(now.words))
        self.words.classes(replace=now.light)


class _Light:
    """The button of a step. It stays where it is, so that neither a click nor the focus is lost
    where its light changes."""

    def __init__(self, step: Step, show: Callable[[str], Any]) -> None:
        self.button = ui.button(on_click=lambda: show(step.key)).classes("step")
        self.button.props("no-caps align=left")
        with self.button:
            self.icon = ui.icon("").props("aria-hidden=true size=18px")
            ui.label(step.label).classes("q-ml-sm")
        self.show(step, chosen=False)

    def show(self, step: Step, *, chosen: bool) -> None:
        """How the step stands now, and whether the page shows it."""
        icon, said = words.LIGHTS[step.light]
        current = "step" if chosen else "false"
        self.button.props(f'flat aria-label="{step.label}: {said}" aria-current={current}')
        self.icon.set_name(icon)
        self.icon.classes(replace=step.light)


# The foot of a page: the run that goes on or the last one, with its progress and time left.


RUN_HERE = ("init", "check", "plan", "calibrate", "verify", "export", "correct")
"""Commands that a step runs too."""
SAID = 1_500
"""Characters of what a failed run said that are shown at once; the end of it."""


class ShownRun:
    """The run that goes on, or the last one, at the foot of a page."""

    def __init__(self, session: Session, foot: Any) -> None:
        self.session, self.foot = session, foot
        self.progress: Any = None
        self.left: Any = None
        place = Place(self.draw)
        self.parts = [Part(self.state, place.refresh), Part(self.going, self.follow)]

    def state(self) -> object:
        """What is drawn anew: the run, and how it has ended."""
        run = self.session.worker.run
        return run, run and run.code, self.session.finished, self._unfinished()

    def going(self) -> object:
        """How far the run has come."""
        run = self.session.worker.run
        return run and run.progress

    def _unfinished(self) -> str | None:
        entry = None
        if self.session.worker.run is None:
            entry = self.session.folder.log().unfinished()
        return None if entry is None else str(entry.record.get("command"))

    def draw(self) -> None:
        """Show the whole."""
        run, unfinished = self.session.worker.run, self._unfinished()
        self.foot.set_value(run is not None or unfinished is not None)
        self.foot.props(f"data-finished={self.session.finished}")
        self.progress = self.left = None
        if unfinished is not None:
            ui.label(words.UNFINISHED.format(command=unfinished)).classes("care")
        if run is None:
            return
        with ui.row().classes("items-center w-full q-gutter-sm"):
            ui.label(run.action.what).classes("text-subtitle2")
            command(run.action.command).classes("text-caption gt-sm")
            ui.space()
            if run.code is None:
                ui.spinner(size="sm")
                self.progress, self.left = ui.label(run.progress or words.RUNNING), ui.label()
                ui.button(words.CANCEL, on_click=self.session.worker.cancel).props("outline")
            else:
                _end(run)
        if run.code not in (None, 0) and not run.cancelled:
            said = run.text[max(run.text.rfind("loopcal: "), 0) :][-SAID:]
            with ui.expansion(shortened(said)).classes("why"):
                text_block(said)
            self._next(run, next_command(said))

    def _next(self, run: Run, line: list[str] | None) -> None:
        """The command that mends what was wrong, to be run by a press."""
        if line is None:
            return
        action = self.session.action(run.action.what, line)

        def start() -> None:
            try:
                self.session.start(action)
            except LoopcalError as error:
                ui.notify(error.text, type="negative")

        with ui.row().classes("items-center w-full q-gutter-sm"):
            ui.button(words.RUN_NEXT, on_click=start).props("unelevated")
            command(action.command).classes("text-caption")

    def follow(self) -> None:
        """Show the progress alone."""
        run = self.session.worker.run
        if self.progress is not None and run is not None:
            self.progress.set_text(run.progress or words.RUNNING)
            seconds = seconds_left(run.progress, time.monotonic() - run.began)
            self.left.set_text("" if seconds is None else words.LEFT.format(seconds=seconds))


def _end(run: Run) -> None:
    """How a run has ended, and what it printed."""
    if run.cancelled:
        ui.label(words.CANCELLED)
    elif run.code is not None and run.code < 0:
        ui.label(words.KILLED).classes("bad")
    elif run.code == 0:
        ui.label(words.DONE).classes("good")
    else:
        ended = words.ENDED.format(code=run.code)
        ui.label(f"{ended}: {words.MEANING.get(run.code or 0, '')}").classes("bad")
    if run.text:
        with ui.dialog() as output, ui.card().classes("w-full").style("max-width: 70rem"):
            text_block(run.text)
            ui.button(words.CLOSE, on_click=output.close)
        ui.button(words.OUTPUT, on_click=output.open).props("flat")


def next_command(said: str) -> list[str] | None:
    r"""The words behind `loopcal` of the next command that a message names; None where the app
    does not run it.

    >>> next_command("loopcal: no\n  Next command:\n    loopcal init a.csv --infer-units")
    ['init', 'a.csv', '--infer-units']
    """
    _, named, rest = said.partition(NEXT_COMMAND)
    lines = rest.strip().splitlines()
    try:
        program, *line = shlex.split(lines[0]) if named and lines else [""]
    except ValueError:  # a quotation that is not closed
        return None
    return line if program == "loopcal" and line and line[0] in RUN_HERE else None


def seconds_left(progress: str, passed: float) -> int | None:
    """Seconds that a run still takes, from a line such as "20 of 90 fits"; None where unknown.

    >>> seconds_left("30 of 90 fits", 10.0)
    20
    """
    match = re.search(r"(\d+) of (\d+)", progress)
    done, total = (int(part) for part in match.groups()) if match else (0, 0)
    return round(passed * (total - done) / done) if 0 < done <= total else None
