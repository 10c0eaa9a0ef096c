"""A user at a page of the app: what a hand does there."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class Hand:
    """Points, clicks and drags; page: of playwright; folder: that of the server."""

    page: Any
    folder: Path = Path()

    def step(self, name: str) -> None:
        """Go to a step."""
        button = self.page.locator(f'button.step[aria-label^="{name}:"]')
        if not button.is_visible():
            self.page.get_by_label("Steps", exact=True).click()
        button.click()
        self.page.get_by_role("heading", name=name, exact=True, level=1).wait_for()

    def press(self, name: str | re.Pattern[str]) -> None:
        """Press a button."""
        self.page.locator(".q-page").get_by_role("button", name=name).first.click()

    def run(self, name: str, ends: str = "done") -> None:
        """Press a button that runs a command, and wait until it has ended so."""
        bar = self.page.locator(".run")
        before = int(bar.get_attribute("data-finished"))
        self.press(name)
        self.page.locator(f'.run[data-finished="{before + 1}"]').wait_for(state="attached")
        told = bar.inner_text()
        assert ends in told, told

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        self.page.get_by_label(label, exact=True).first.click()
        self.page.get_by_role("option", name=option).first.click()

    def drop(self, label: str, *files: Path) -> None:
        """Hand in files."""
        box = self.page.locator(".q-uploader", has_text=label).locator("input[type=file]")
        box.set_input_files([str(file) for file in files])

    def brush(self, label: str, begin: float, end: float) -> None:
        """Drag over the points of a figure between two values of its x axis."""
        plot = self.page.get_by_label(label, exact=True)
        plot.evaluate("e => e.scrollIntoView({block: 'center'})")
        plot.locator(".nsewdrag").first.wait_for()
        box = plot.locator(".nsewdrag").first.bounding_box()
        low, high = plot.evaluate(
            "e => (e.querySelector('.js-plotly-plot') ?? e)._fullLayout.xaxis.range"
        )
        across = [box["x"] + box["width"] * (v - low) / (high - low) for v in (begin, end)]
        self.page.mouse.move(across[0], box["y"] + 2)
        self.page.mouse.down()
        self.page.mouse.move(across[1], box["y"] + box["height"] - 2, steps=4)
        self.page.mouse.up()
        self.page.get_by_text(re.compile("poses selected")).wait_for()

    def end_at(self, label: str, pose: int) -> None:
        """Move an end of the selected run pose by pose; label: of its field."""
        field = self.page.get_by_label(label, exact=True)
        self.page.wait_for_function("e => e.value !== ''", arg=field.element_handle())
        while (off := int(field.input_value()) - pose) != 0:
            before = field.input_value()
            self.press(f"{label}: one pose {'earlier' if off > 0 else 'later'}")
            moved = "([e, before]) => e.value !== before"
            self.page.wait_for_function(moved, arg=[field.element_handle(), before])

    def frame_in_space(self) -> None:
        """Draw a frame around all points of the figure in space."""
        pane = self.page.locator(".pane")
        pane.evaluate("e => e.scrollIntoView({block: 'center'})")
        box = pane.bounding_box()
        ends = [(box["x"] + s * box["width"], box["y"] + s * box["height"]) for s in (0.01, 0.99)]
        self.page.mouse.move(*ends[1])
        self.page.mouse.down()
        self.page.mouse.move(*ends[0], steps=4)
        self.page.mouse.up()

    def sees(self, text: str | re.Pattern[str]) -> None:
        """Wait until the page shows this."""
        self.page.get_by_text(text).first.wait_for()

    def sees_stale(self) -> None:
        """Wait until the page says that the result is not of the project as it stands."""
        self.sees(re.compile("The project has changed since this result|Provisional: error"))
