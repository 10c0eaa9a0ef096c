"""What the timings of the app share: a page at the step Diagnose, and how times are printed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from tests.app.pointing import Hand
from tests.app.serving import serving
from tests.browser import chromium

SETTLED = 3000
"""Milliseconds after which a page that was opened has drawn all its figures."""


@contextmanager
def diagnosing(folder: Path) -> Iterator[Hand]:
    """A hand at the step Diagnose of a folder with a result, in Chromium."""
    with serving(folder) as served, chromium() as browser:
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.set_default_timeout(120_000)
        page.goto(served.address)
        hand = Hand(page, folder)
        hand.step("Diagnose")
        page.get_by_label("error over the poses", exact=True).locator(".nsewdrag").first.wait_for()
        page.wait_for_timeout(SETTLED)
        yield hand
        page.close()


def printed(name: str, times: Sequence[float]) -> None:
    """Print the median, the least and the largest [ms]."""
    print(f"{name}: median {median(times):.0f} ms, {min(times):.0f} to {max(times):.0f} ms")
