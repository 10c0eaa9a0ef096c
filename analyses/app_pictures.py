"""Make the pictures of the tutorial of the app: its path through the example, step by step.

    python -m analyses.app_pictures

It needs Chromium, playwright and NiceGUI (`make partners`).
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest

from tests.app.pointing import Hand
from tests.app.serving import serving
from tests.browser import chromium
from tests.reference.dh_arm import SLIPPED

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "slipped_reflector"
PICTURES = ROOT / "docs" / "pictures" / "app"
SIZE = {"width": 1280, "height": 720}


def main() -> None:
    """Write a picture of every step."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        cell = Path(folder) / "cell"
        cell.mkdir()
        with serving(cell) as served, chromium() as browser:
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(180_000)
            page.goto(served.address)
            _walk(Hand(page, cell))
    print(f"written to {PICTURES.relative_to(ROOT)}")


def _walk(hand: Hand) -> None:
    hand.drop("Drop the URDF here", EXAMPLE / "arm.urdf")
    hand.sees("Go on with the step Data")
    _picture(hand, "robot")
    hand.step("Data")
    hand.drop("Drop the files of readings here", EXAMPLE / "poses.csv")
    hand.run("Recognise")
    hand.sees("60 poses")
    _picture(hand, "data", "Columns")
    hand.step("Plan")
    hand.run("Choose poses")
    hand.sees("Download plan.csv")
    _picture(hand, "plan")
    hand.step("Check")
    hand.run("Check")
    hand.sees("Parameters, and the sds to expect")
    _picture(hand, "check")
    hand.step("Fit")
    hand.choose("Method", "least-squares")
    hand.run("Calibrate", "exit code 4")
    _picture(hand, "fit")
    hand.step("Diagnose")
    hand.brush("error over the poses", SLIPPED - 0.5, 60.5)
    hand.sees("30 of 60 poses selected")
    _picture(hand, "diagnose")
    hand.press("Reflector moved here")
    hand.sees_stale()
    hand.sees("Provisional: error")
    _picture(hand, "provisional")
    hand.step("Fit")
    hand.choose("Method", "implicit-loop: ")
    hand.choose("Validate on", "10 parts")
    hand.run("Calibrate")
    _picture(hand, "refit")
    hand.step("Validate")
    hand.sees("Predict one pose")
    _picture(hand, "validate", "Predicted sd over the working region")
    hand.step("Deploy")
    hand.choose("Your own file", "arm.urdf")
    hand.run("Preview")
    hand.sees("Lines that change are marked")
    _picture(hand, "deploy", "Lines that change are marked")
    hand.run("Write")
    hand.step("History")
    hand.run("Add this result")
    _picture(hand, "history")


def _picture(hand: Hand, name: str, at: str = "") -> None:
    """A picture of the window; at: a text at its top, else it shows the top of the page."""
    hand.page.mouse.move(SIZE["width"] - 2, 100)
    hand.page.evaluate("window.scrollTo(0, 0)")
    if at:
        text = hand.page.get_by_text(at).first
        text.evaluate("e => window.scrollTo(0, e.getBoundingClientRect().top + scrollY - 120)")
    hand.page.wait_for_function("!document.querySelector('.q-tooltip, .q-notification')")
    hand.page.wait_for_timeout(1500)  # figures in space draw when they like
    hand.page.screenshot(path=PICTURES / f"{name}.png")


if __name__ == "__main__":
    try:
        main()
    except pytest.skip.Exception as absent:
        sys.exit(str(absent))
