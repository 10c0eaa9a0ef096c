"""What was done in the folder, how to undo it, and the machine over time."""

from __future__ import annotations

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import offer, page, text
from loopcal.companions.app.view import View, figure, heading, table
from loopcal.companions.life.history import History
from loopcal.companions.life.history_folder import read_entries
from loopcal.companions.life.pages import history_parts
from loopcal.errors import LoopcalError
from loopcal.presentation.shown import Table

FOLDER = "machine.history"


def show(view: View) -> None:
    """The step."""
    _done(view)
    _machine(view)


def _done(view: View) -> None:
    """The log of the folder."""
    log = view.session.folder.log()
    heading(words.FOLDER_LOG)
    if log.edits():
        last = log.edits()[-1]
        undo = ui.button(words.UNDO.format(what=last.what), icon="undo").props("outline")
        undo.on_click(lambda: view.act(view.session.folder.undo))
    if log.broken:
        lines = ", ".join(map(str, log.broken))
        ui.label(words.LOG_BROKEN.format(lines=lines)).classes("care")
    undone = {entry.record.get("of") for entry in log.entries if entry.kind == "undo"}
    rows = [
        [
            str(e.number),
            e.at.replace("T", " ")[:19],
            e.what + (" (undone)" if e.number in undone else ""),
            str(e.record.get("reason", "")),
            str(e.record.get("command", "")),
            _end(e.record.get("code")),
        ]
        for e in reversed(log.entries)
        if e.kind != "begun"
    ]
    table(["no.", "time (UTC)", "what", "reason", "command", "exit code"], rows, pagination=10)


def _machine(view: View) -> None:
    """The history of the machine: what was added, and how it changed."""
    heading(words.MACHINE_OVER_TIME)
    ui.label(words.MACHINE).classes("text-body2")
    if view.session.source() is not None:
        result = view.session.folder.result.name
        line = ("history", FOLDER, "--add", result)
        offer(view, words.ADD_THIS_RESULT, lambda: line, what=words.ADD_HISTORY)
    text(view, "history.event", words.EVENT)

    def event() -> list[str]:
        return ["history", FOLDER, "--event", str(view.kept["history.event"]).strip()]

    offer(view, words.ADD_THIS_EVENT, event, what=words.ADD_HISTORY)
    try:
        history = History(read_entries(view.session.folder.inside(FOLDER)))
        parts = history_parts(history)
    except LoopcalError as error:
        message = words.NO_HISTORY if error.code == "missing-file" else error.text
        ui.label(message)
        return
    for sentence in history.words():
        ui.label(sentence)
    page(f"{FOLDER}.html", words.OPEN_PAGE_HISTORY)
    for one in parts:
        if isinstance(one, Table):
            heading(one.caption)
            table(one.head, one.rows)
        else:
            figure(one)


def _end(code: object) -> str:
    return "" if code is None else str(code)
