"""The page in Chromium: it opens, asks nobody else, and is no wider than its window."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.app.serving import Served, asked, serving
from tests.browser import chromium
from tests.command_line import run

STEPS = ("Robot", "Data", "Plan", "Check", "Fit", "Diagnose", "Validate", "Deploy", "History")
GONE = "Resize must be passed a displayed plot div element"
"""What plotly throws, without harm, where a figure goes while it measures itself."""
SIZES = {"desktop": (1440, 900), "tablet": (820, 1180)}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The app on a project that was simulated and calibrated by the command line."""
    folder = tmp_path_factory.mktemp("app") / "arm"
    for line in (
        ("new", folder, "--mechanism", "planar-two-link"),
        ("simulate", folder / "project.toml", "--out", folder / "poses.csv", "--seed", "1"),
        ("calibrate", folder / "project.toml"),
    ):
        done = run(*line)
        assert done.returncode == 0, done.stderr
    with serving(folder) as server:
        yield server


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.mark.parametrize("size", SIZES)
def test_every_step_opens_without_complaint_and_asks_nobody_else(
    served: Served, browser: Any, size: str
) -> None:
    width, height = SIZES[size]
    page = browser.new_page(viewport={"width": width, "height": height})
    complaints: list[str] = []
    elsewhere: list[str] = []
    page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda e: complaints.append(str(e)) if GONE not in str(e) else None)
    own = (served.address, served.address.replace("http", "ws"), "data:", "blob:")
    page.on("request", lambda r: elsewhere.append(r.url) if not r.url.startswith(own) else None)
    page.goto(served.address)
    for step in STEPS:
        page.locator(f'button[aria-label^="{step}:"]').click()
        page.get_by_role("heading", name=step, level=1).wait_for()
        wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert wide <= 0, f"{step} is {wide} pixels wider than the window"
    page.close()
    assert complaints == []
    assert elsewhere == []


def test_scripts_run_by_a_nonce_only(served: Served) -> None:
    policy = asked(served.address).headers["content-security-policy"]
    scripts = next(part for part in policy.split(";") if part.strip().startswith("script-src"))
    assert "'nonce-" in scripts
    assert "'unsafe-inline'" not in scripts
    assert "*" not in policy
