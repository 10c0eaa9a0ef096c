"""What the readings can determine, before a fit."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.controls import offer, printed
from loopcal.app.view import View


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return
    offer(view, words.CHECK, lambda: ("check", view.project_name()))
    printed(view, "check")
