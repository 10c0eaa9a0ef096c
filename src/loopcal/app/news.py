"""How pages learn that something has changed: by one subscription each."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from typing import Any

APART = 0.02
"""Least seconds between two updates of a page."""


class News:
    """Tells every page that there is something new in the folder, in the run or in the first fit.

    What it is, a page sees for itself (`view.Part`): one that comes late has missed nothing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._heard: tuple[Callable[[], Any], ...] = ()

    def subscribe(self, hear: Callable[[], Any]) -> Callable[[], None]:
        """Call `hear` from now on, in any thread; what is returned ends that."""
        with self._lock:
            self._heard += (hear,)

        def end() -> None:
            with self._lock:
                self._heard = tuple(one for one in self._heard if one is not hear)

        return end

    async def each(self) -> AsyncGenerator[None, None]:
        """Once now, and whenever there is something new; much at a time counts once."""
        new, loop = asyncio.Event(), asyncio.get_running_loop()
        new.set()

        def hear() -> None:
            with suppress(RuntimeError):  # the server is ending
                loop.call_soon_threadsafe(new.set)

        end = self.subscribe(hear)
        try:
            while True:
                await new.wait()
                # Cleared ahead of the drawing: what happens meanwhile is new again.
                new.clear()
                yield
                await asyncio.sleep(APART)
        finally:
            end()

    def tell(self) -> None:
        """There is something new."""
        for hear in self._heard:
            hear()
