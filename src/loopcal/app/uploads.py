"""Files handed in through the page: kept in the folder, never executed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from loopcal.app import words
from loopcal.app.guard import LARGEST
from loopcal.app.view import View

FILES = "document.querySelector('#{box} input[type=file]')"


def uploader(view: View, label: str, then: Callable[[str], Any] | None = None) -> None:
    """A place to drop files, and a button to choose them; then: called with the name of each."""

    async def taken(event: Any) -> None:
        content = await event.file.read()

        def take() -> None:
            path = view.session.folder.take(event.file.name, content)
            if then is not None:
                then(path.name)

        view.act(take)

    def going(on: bool) -> None:
        view.uploading = on
        view.session.news.tell()

    box = ui.upload(
        label=label,
        multiple=True,
        auto_upload=True,
        max_file_size=LARGEST,
        on_upload=taken,
        on_rejected=lambda: ui.notify(words.TOO_LARGE, type="negative"),
    )
    box.on("start", lambda: going(True)).on("finish", lambda: going(False))
    box.classes("w-full").props("flat bordered")
    button = ui.button(words.CHOOSE_FILES, icon="upload_file").props("outline")
    button.props(f'aria-label="{label}: {words.CHOOSE_FILES}"')
    # Every act has a way by keyboard (docs/decisions/0095).
    button.on("click", js_handler=f"() => {FILES.format(box=box.html_id)}.click()")
