"""What the readings can determine, before a fit."""

from __future__ import annotations

from nicegui import ui

from loopcal.app import words
from loopcal.app.view import View


def show(view: View) -> None:
    """The step."""
    if view.session.project() is None:
        ui.label(view.session.objection() or words.NO_PROJECT).classes("printed")
        return

    async def check() -> None:
        await view.run_to_end("Check the project", "check", view.project_name())

    ui.button("Check", on_click=check).props("unelevated")
