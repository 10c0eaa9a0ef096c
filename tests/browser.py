"""Chromium without a window, as tests of pages use it; tests skip where it is absent."""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
ARGUMENTS += ["--enable-unsafe-swiftshader", "--disable-gpu-compositing"]
"""Without a graphics processor: figures in space by SwiftShader, the page itself without it."""


@dataclass
class Seen:
    """An opened page, what it asked for beside itself, and what it complained about."""

    page: Any
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


PATIENCE = 240_000
"""Milliseconds that a page may take on a busy machine."""
DECODED = "Promise.all([...document.images].map((image) => image.decode()))"
"""Until every picture of a page has its size."""
_STARTED: list[Any] = []
"""The browser of this process: playwright starts once only."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser of this process; skips the test where playwright or Chromium is absent."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is absent; `make partners` installs it"
    )
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("chromium is absent; `make partners` installs it")
    if not _STARTED:
        stack = ExitStack()
        playwright = stack.enter_context(sync_api.sync_playwright())
        _STARTED.append(playwright.chromium.launch(executable_path=path, args=ARGUMENTS))
        stack.callback(_STARTED[0].close)
        atexit.register(stack.close)
    yield _STARTED[0]


def expect(where: Any) -> Any:
    """Playwright's assertions about a page or a part of it, which wait until they hold."""
    from playwright.sync_api import expect as assertions

    assertions.set_options(timeout=PATIENCE)
    return assertions(where)


def until(page: Any, so: Callable[[], bool]) -> None:
    """Wait for what a page does not show; it works meanwhile."""
    for _ in range(PATIENCE // 25):
        if so():
            return
        page.wait_for_timeout(25)
    raise AssertionError("what was waited for did not come")


@contextmanager
def opened(
    browser: Any, path: Path, *, width: int = 1440, drawn: bool = True, **context: Any
) -> Iterator[Seen]:
    """A page from the disk, all its figures drawn where it has any."""
    where = browser.new_context(viewport={"width": width, "height": 900}, **context)
    where.set_default_timeout(PATIENCE)
    seen = Seen(where.new_page())
    address = path.resolve().as_uri()

    def asked(request: Any) -> None:
        # blob: and data: are the page's own memory
        if request.url != address and not request.url.startswith(("blob:", "data:")):
            seen.requests.append(request.url)

    def said(message: Any) -> None:
        if message.type == "error":
            seen.complaints.append(message.text)

    seen.page.on("request", asked)
    seen.page.on("console", said)
    seen.page.on("pageerror", lambda error: seen.complaints.append(str(error)))
    seen.page.goto(address)
    if drawn:
        seen.page.wait_for_selector("body[data-drawn=all]")
        seen.page.evaluate(DECODED)
    yield seen
    where.close()
