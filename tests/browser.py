"""Chromium without a window, as tests of pages use it; tests skip where it is absent."""

from __future__ import annotations

import atexit
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import gettempdir
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
_FIRST: list[Any] = []
"""The page that opens all others from the disk, which share its process."""
_SHOWN = Path(gettempdir()).resolve() / f"loopcal-page-{os.getpid()}.html"
"""The name of all of them: so Chromium knows plotly's 5 MB again, which it compiles for longer than
all else of most pages takes."""


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
    browser: Any,
    path: Path,
    *,
    width: int = 1440,
    drawn: bool = True,
    scheme: str = "light",
) -> Iterator[Seen]:
    """A page from the disk, all its figures drawn where it has any; its reader may copy."""
    if not _FIRST:
        where = browser.new_context(permissions=["clipboard-read", "clipboard-write"])
        _FIRST.append(where.new_page())
        _FIRST[0].goto(Path(__file__).parent.as_uri())
        atexit.register(_SHOWN.unlink, missing_ok=True)
    with _FIRST[0].expect_popup() as popup:
        _FIRST[0].evaluate("open('about:blank')")
    seen = Seen(popup.value)
    seen.page.set_default_timeout(PATIENCE)
    seen.page.set_viewport_size({"width": width, "height": 900})
    seen.page.emulate_media(color_scheme=scheme)
    shutil.copy(path, _SHOWN)
    address = _SHOWN.as_uri()

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
    seen.page.close()
