"""The foot of a page: the run that goes on or the last one, with its progress and time left."""

from __future__ import annotations

import re
import time
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.session import Session
from loopcal.app.view import Part, text_block
from loopcal.app.worker import Run

SAID = 1_500
"""Characters of what a failed run said that are shown at once; the end of it."""


class ShownRun:
    """The run that goes on, or the last one, at the foot of a page."""

    def __init__(self, session: Session, foot: Any) -> None:
        self.session, self.foot = session, foot
        self.progress: Any = None
        self.left: Any = None
        place = ui.refreshable(self.draw)
        self.parts = [Part(self.state, place.refresh), Part(self.going, self.follow)]
        place()

    def state(self) -> object:
        """What is drawn anew: the run, and how it has ended."""
        its = self.session.worker.run
        return its, its and its.code, self.session.finished, self._unfinished()

    def going(self) -> object:
        """How far the run has come."""
        its = self.session.worker.run
        return its and its.progress

    def _unfinished(self) -> str | None:
        found = None
        if self.session.worker.run is None:
            found = self.session.folder.log().unfinished()
        return None if found is None else str(found.told.get("command"))

    def draw(self) -> None:
        """Show the whole."""
        its, unfinished = self.session.worker.run, self._unfinished()
        self.foot.set_value(its is not None or unfinished is not None)
        self.foot.props(f"data-finished={self.session.finished}")
        self.progress = self.left = None
        if unfinished is not None:
            ui.label(words.UNFINISHED.format(command=unfinished)).classes("care")
        if its is None:
            return
        with ui.row().classes("items-center w-full q-gutter-sm"):
            ui.label(its.action.what).classes("text-subtitle2")
            ui.code(its.action.command, language="bash").classes("text-caption gt-sm command")
            ui.space()
            if its.code is None:
                ui.spinner(size="sm")
                self.progress, self.left = ui.label(its.progress or words.RUNNING), ui.label()
                ui.button(words.CANCEL, on_click=self.session.worker.cancel).props("outline")
            else:
                _end(its)
        if its.code not in (None, 0) and not its.cancelled:
            text_block(its.text[max(its.text.rfind("loopcal: "), 0) :][-SAID:])

    def follow(self) -> None:
        """Show the progress alone."""
        its = self.session.worker.run
        if self.progress is not None and its is not None:
            self.progress.set_text(its.progress or words.RUNNING)
            seconds = seconds_left(its.progress, time.monotonic() - its.began)
            self.left.set_text("" if seconds is None else words.LEFT.format(seconds=seconds))


def _end(its: Run) -> None:
    """How a run has ended, and what it printed."""
    if its.cancelled:
        ui.label(words.CANCELLED)
    elif its.code is not None and its.code < 0:
        ui.label(words.KILLED).classes("bad")
    elif its.code == 0:
        ui.label(words.DONE).classes("good")
    else:
        ended = words.ENDED.format(code=its.code)
        ui.label(f"{ended}: {words.MEANING.get(its.code or 0, '')}").classes("bad")
    if its.text:
        with ui.dialog() as output, ui.card().classes("w-full").style("max-width: 70rem"):
            text_block(its.text)
            ui.button(words.CLOSE, on_click=output.close)
        ui.button(words.OUTPUT, on_click=output.open).props("flat")


def seconds_left(progress: str, passed: float) -> int | None:
    """Seconds that a run still takes, from a line such as "20 of 90 fits"; None where unknown.

    >>> seconds_left("30 of 90 fits", 10.0)
    20
    """
    found = re.search(r"(\d+) of (\d+)", progress)
    done, total = (int(part) for part in found.groups()) if found else (0, 0)
    return round(passed * (total - done) / done) if 0 < done <= total else None
