"""Files handed in through the page: kept in the folder, never executed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.guard import LARGEST
from loopcal.app.view import View


def uploader(view: View, label: str, then: Callable[[str], Any] | None = None) -> None:
    """A place to drop files, and a button for it; then: called with the name of each file."""

    async def taken(event: Any) -> None:
        content = await event.file.read()

        def take() -> None:
            path = view.session.folder.take(event.file.name, content)
            if then is not None:
                then(path.name)

        view.act(take)

    ui.upload(
        label=label,
        multiple=True,
        auto_upload=True,
        max_file_size=LARGEST,
        on_upload=taken,
        on_rejected=lambda: ui.notify(words.TOO_LARGE, type="negative"),
    ).classes("w-full").props("flat bordered")
