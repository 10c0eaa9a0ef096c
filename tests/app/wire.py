"""The connection of a page to its server; what the server says can come late."""

from __future__ import annotations

import re
from typing import Any

from tests.browser import until


class Wire:
    """Between a page and its server, from before the page is opened."""

    def __init__(self, page: Any) -> None:
        self._page = page
        self._to_page: Any = None
        self._held: list[Any] | None = None
        page.route_web_socket(re.compile("socket.io"), self._begun)

    def _begun(self, to_page: Any) -> None:
        self._to_page = to_page
        server = to_page.connect_to_server()
        to_page.on_message(server.send)
        server.on_message(self._said)

    def _said(self, message: Any) -> None:
        if self._held is not None and str(message).startswith("42"):  # no sign of life
            self._held.append(message)
        else:
            self._to_page.send(message)

    def hold(self) -> None:
        """Keep back what the server says from now on."""
        self._held = []

    def wait(self, kind: str) -> None:
        """Wait until the server has said something of a kind that the page has not heard."""

        def heard() -> bool:
            return any(str(message).startswith(f'42["{kind}"') for message in self._held or ())

        until(self._page, heard)

    def release(self) -> None:
        """Let the page hear all of it."""
        held, self._held = self._held or [], None
        for message in held:
            self._to_page.send(message)
