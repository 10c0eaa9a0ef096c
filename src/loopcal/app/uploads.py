"""Files handed in through the page: kept in the folder, never executed."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.guard import LARGEST
from loopcal.app.view import View


def uploader(view: View, label: str) -> None:
    """A place to drop files, and a button for it."""

    async def taken(event: Any) -> None:
        content = await event.file.read()
        view.act(lambda: view.session.folder.take(event.file.name, content))

    ui.upload(
        label=label,
        multiple=True,
        auto_upload=True,
        max_file_size=LARGEST,
        on_upload=taken,
        on_rejected=lambda: ui.notify(words.TOO_LARGE, type="negative"),
    ).classes("w-full").props("flat bordered")
