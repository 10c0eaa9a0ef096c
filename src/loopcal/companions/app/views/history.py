"""What was done in the folder, how to undo it, and the machine over time."""

from __future__ import annotations

from difflib import unified_diff

from nicegui import ui

from loopcal.companions.app import words
from loopcal.companions.app.controls import offer, page, text
from loopcal.companions.app.project_folder import Entry
from loopcal.companions.app.view import View, command, difference, figure, heading, table
from loopcal.companions.life.history import History
from loopcal.companions.life.history_folder import read_entries
from loopcal.companions.life.pages import history_parts
from loopcal.errors import LoopcalError
from loopcal.presentation.shown import Table

FOLDER = "machine.history"
NUMBER = (
    '<q-td :props="props"><a :href="\'/history?run=\' + props.value">{{ props.value }}</a></q-td>'
)
"""The number of a line of the log, with its address."""


def show(view: View) -> None:
    """The step."""
    if view.entry is not None:
        _entry(view, view.entry)
    _done(view)
    _machine(view)


def _entry(view: View, number: int) -> None:
    """One line of the log, with what it changed in the project."""
    entry = next((e for e in view.session.folder.log().entries if e.number == number), None)
    if entry is None:
        ui.label(words.NO_ENTRY.format(number=number)).classes("care")
        return
    record = entry.record
    with ui.element("section").classes("card"):
        title = ui.label(f"{entry.number}: {entry.what}").classes("card-title")
        title.props("role=heading aria-level=2")
        ui.label(f"{_time(entry)} UTC {record.get('reason') or ''}").classes("detail")
        if record.get("command"):
            command(str(record["command"]))
            ui.label(words.ENDED.format(code=_end(record.get("code")))).classes("detail")
        texts = record.get("before"), record.get("after")
        if entry.kind == "edit":
            old, new = (text.splitlines() if isinstance(text, str) else [] for text in texts)
            difference([*unified_diff(old, new, "before", "after", lineterm="", n=1)])


def _time(entry: Entry) -> str:
    return entry.at.replace("T", " ")[:19]


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
            _time(e),
            e.what + (" (undone)" if e.number in undone else ""),
            str(e.record.get("reason", "")),
            str(e.record.get("command", "")),
            _end(e.record.get("code")),
        ]
        for e in reversed(log.entries)
        if e.kind != "begun"
    ]
    if not rows:
        ui.label(words.NOTHING_DONE)
        return
    head = ["no.", "time (UTC)", "what", "reason", "command", "exit code"]
    made = table(head, rows, pagination=10)
    made.add_slot("body-cell-0", NUMBER)


def _machine(view: View) -> None:
    """The history of the machine: what was added, and how it changed."""
    heading(words.MACHINE_OVER_TIME)
    ui.label(words.MACHINE).classes("text-body2")
    if view.session.source() is not None:
        line = ("history", FOLDER, "--add", view.result_name())
        offer(view, words.ADD_THIS_RESULT, lambda: line, what=words.ADD_HISTORY)
    text(view, "history.event", words.EVENT)

    def event() -> list[str]:
        return ["history", FOLDER, "--event", str(view.kept["history.event"]).strip()]

    offer(view, words.ADD_THIS_EVENT, event, what=words.ADD_HISTORY, look="outline")
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
