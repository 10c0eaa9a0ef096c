"""The page: steps with their lights at the side, the step itself, and the run below it."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Callable
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nicegui import background_tasks, run, ui

from loopcal.app import steps, words
from loopcal.app.session import Session
from loopcal.app.steps import Light, State
from loopcal.app.view import Part, Place, View, text_block, title
from loopcal.app.views import check, data, deploy, diagnose, fit, history, plan, robot, validate
from loopcal.app.worker import Run
from loopcal.errors import LoopcalError
from loopcal.presentation.shown import shortened

SCRIPTS = {"/linked.js": "linked.js", "/fields.js": "fields.js"}
"""Programs of the page, by their addresses."""
TIP = 'anchor="center right" self="center left"'
PATIENCE = 0.3
"""Seconds before a page says that it waits for files."""
STYLE = Path(__file__).with_name("scripts") / "style.css"


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


# The pages of the app in their order: a row for each step of the work.


@dataclass(frozen=True)
class Page:
    """words: what is done there; light: how its step stands; show: draws it."""

    label: str
    words: str
    light: Light
    show: Callable[[View], None]

    @property
    def key(self) -> str:
        """Its name in the code."""
        return self.label.lower()


PAGES = (
    Page(
        "Robot",
        "Describe the robot: a URDF, a table of Denavit-Hartenberg parameters, or a type.",
        steps.made("a robot"),
        robot.show,
    ),
    Page(
        "Data",
        "Give the readings. loopcal recognises columns and units; correct what is wrong.",
        steps.made("readings"),
        data.show,
    ),
    Page(
        "Plan",
        "Choose which poses to measure. Skip this step if you have measured already.",
        steps.ran("plan", "which poses to measure"),
        plan.show,
    ),
    Page(
        "Check",
        "See what the readings can determine, before a fit.",
        steps.checked,
        check.show,
    ),
    Page(
        "Fit",
        "Calibrate, and read whether you can use the result.",
        steps.fit,
        fit.show,
    ),
    Page(
        "Diagnose",
        "Find what does not fit. Drag over points to select poses; all figures follow.",
        steps.of_result(steps.diagnose),
        diagnose.show,
    ),
    Page(
        "Validate",
        "See how good the calibration is where nothing was measured.",
        steps.of_result(steps.validate),
        validate.show,
    ),
    Page(
        "Deploy",
        "Take the result to the robot: files for its controller, and corrected programs.",
        steps.of_result(steps.deploy),
        deploy.show,
    ),
    Page(
        "History",
        "See what was done here, undo it, and follow the machine over the years.",
        steps.of_result(steps.ran("history", "the machine over time")),
        history.show,
    ),
)
BY_KEY = {page.key: page for page in PAGES}


@dataclass(frozen=True)
class Step:
    """How a step stands; light: of `LIGHTS`; words: why."""

    key: str
    label: str
    light: str
    words: str


def stand(state: State) -> list[Step]:
    """All steps in their order."""
    return [Step(page.key, page.label, *page.light(state)) for page in PAGES]


# The foot of a page: the run that goes on or the last one, with its progress and time left.

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
            ui.code(run.action.command, language="text").classes("text-caption gt-sm command")
            ui.space()
            if run.code is None:
                ui.spinner(size="sm")
                self.progress, self.left = ui.label(run.progress or words.RUNNING), ui.label()
                ui.button(words.CANCEL, on_click=self.session.worker.cancel).props("outline")
            else:
                _end(run)
        if run.code not in (None, 0) and not run.cancelled:
            text_block(run.text[max(run.text.rfind("loopcal: "), 0) :][-SAID:])

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


def seconds_left(progress: str, passed: float) -> int | None:
    """Seconds that a run still takes, from a line such as "20 of 90 fits"; None where unknown.

    >>> seconds_left("30 of 90 fits", 10.0)
    20
    """
    match = re.search(r"(\d+) of (\d+)", progress)
    done, total = (int(part) for part in match.groups()) if match else (0, 0)
    return round(passed * (total - done) / done) if 0 < done <= total else None
