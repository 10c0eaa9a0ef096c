"""The foot of a page: the run that goes on or the last one, with its progress and time left."""

from __future__ import annotations

import re
import shlex
import time
from typing import Any

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.session import Session
from loopcal.companions.app.view import Part, Place, command, text_block
from loopcal.companions.app.worker import Run
from loopcal.errors import LoopcalError
from loopcal.presentation.shown import shortened

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
    _, named, rest = said.partition("Next command:\n")
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
