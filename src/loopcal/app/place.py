"""Parts of a page that are drawn anew without losing what a user does meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from nicegui import background_tasks, ui

LONGEST = 60.0
"""Seconds that a browser may take to show a drawing."""


class Place:
    """A part of a page that can be drawn anew.

    The browser shows a new drawing a while after it was made. Until then clicks and keys go to the
    one before it, which therefore answers until the browser has shown the new one.
    """

    def __init__(self, draw: Callable[[], Any]) -> None:
        self._draw = draw
        self._box = ui.element("div").classes("contents")
        with self._box:
            draw()

    def refresh(self) -> None:
        """Draw it anew."""
        if self._box.is_deleted:
            return
        before = [*self._box.descendants()]
        # Cleared but not removed: elements that are removed answer no click (docs/decisions/0117).
        self._box.default_slot.children.clear()
        self._box.update()
        background_tasks.create(self._forget(before))
        with self._box:
            self._draw()

    async def _forget(self, before: list[Any]) -> None:
        client = self._box.client
        with suppress(TimeoutError):
            await client.run_javascript("true", timeout=LONGEST)  # after all that was sent before
        client.remove_elements([one for one in before if not one.is_deleted])
