"""What was done in the folder, and how to take it back."""

from __future__ import annotations

from nicegui import ui

from loopcal.app.view import View, table


def show(view: View) -> None:
    """The step."""
    log = view.session.folder.log()
    if log.edits():
        last = log.edits()[-1]
        ui.button(f"Undo: {last.what}", on_click=lambda: view.act(view.session.folder.undo)).props(
            "outline"
        )
    if log.broken:
        lines = ", ".join(map(str, log.broken))
        ui.label(f"Lines of the log that cannot be read, and are left out: {lines}").classes("care")
    rows = [
        [
            str(e.number),
            e.at,
            e.what,
            str(e.told.get("reason", "")),
            str(e.told.get("command", "")),
            _end(e.told.get("code")),
        ]
        for e in reversed(log.entries)
    ]
    table(["no.", "time (UTC)", "what", "reason", "command", "exit code"], rows).classes("w-full")


def _end(code: object) -> str:
    return "" if code is None else str(code)
