"""A user at a page of the app: what a hand does there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.browser import PATIENCE, expect

AT_REST = """async (e) => {
  const frame = () => new Promise(requestAnimationFrame);
  const plot = e.querySelector(".js-plotly-plot") ?? e;
  await frame();
  await frame();  // by now the page has seen its size
  await new Promise((done) => linked.plotly(({ Plots }) => Plots.resize(plot).then(done)));
}"""
"""Until plotly has fitted a figure to the place that it has: a drag would not outlive that."""
HEARS = """(text) => {
  (window.heard ??= new Set()).delete(text);
  const look = (mutations) => {
    for (const { addedNodes, target } of mutations)
      if (addedNodes.length)
        for (const node of [...addedNodes, target.closest(".q-notification")])
          if (node?.textContent.includes(text)) heard.add(text);
  };
  new MutationObserver(look).observe(document.body, { childList: true, subtree: true });
}"""
"""Remember a notice, however soon it goes. One that is repeated while it is shown gets a count."""
PHONE = 700
"""Pixels below which the steps are closed."""
DRAWN = "e => JSON.stringify((e.querySelector('.js-plotly-plot') ?? e).data[0].y)"
"""The errors that a figure shows."""


_OPENED: dict[tuple[tuple[str, Any], ...], Any] = {}
"""By look: where pages are opened, so that the next has the scripts that the first has compiled.

Each keeps an empty page: the first page of a window costs Chromium a second, every other one
little.
"""


def new_page(browser: Any, size: tuple[int, int] = (1440, 900), **look: Any) -> Any:
    """An empty page of a size in pixels."""
    look = {"reduced_motion": "reduce", **look}
    key = (*sorted(look.items()),)
    if key not in _OPENED:
        _OPENED[key] = browser.new_context(**look)
        _OPENED[key].new_page()
    page = _OPENED[key].new_page()
    width, height = size
    page.set_viewport_size({"width": width, "height": height})
    page.set_default_timeout(PATIENCE)
    return page


@dataclass
class Hand:
    """Points, clicks and drags; page: of playwright; folder: that of the server."""

    page: Any
    folder: Path = Path()

    def step(self, name: str) -> None:
        """Go to a step; on a phone the steps lie over the page as long as they are shown."""
        phone = self.page.viewport_size["width"] < PHONE
        if phone:
            self.page.get_by_role("button", name="Steps", exact=True).click()
        self.page.locator(f'button.step[aria-label^="{name}:"]').click()
        self.page.get_by_role("heading", name=name, exact=True, level=1).wait_for()
        if phone:
            expect(self.page.locator(".q-drawer__backdrop:not(.hidden)")).to_have_count(0)

    def press(self, name: str | re.Pattern[str]) -> None:
        """Press a button."""
        self.page.locator(".q-page").get_by_role("button", name=name).first.click()

    def run(self, name: str | re.Pattern[str], ends: str = "done") -> None:
        """Press a button that runs a command, and wait until it has ended so."""
        bar = self.page.locator(".run")
        before = int(bar.get_attribute("data-finished"))  # each run ends before the next
        self.press(name)
        self.page.locator(f'.run[data-finished="{before + 1}"]').wait_for(state="attached")
        expect(bar).to_contain_text(ends)

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
        pane = plot.locator(".nsewdrag").first
        pane.evaluate("e => e.scrollIntoView({block: 'center'})")
        plot.evaluate(AT_REST)
        pane.hover()  # waits until it no longer moves
        box = pane.bounding_box()
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
        while (off := int(before := self.written(label)) - pose) != 0:
            self.press(f"{label}: one pose {'earlier' if off > 0 else 'later'}")
            expect(self.page.get_by_label(label, exact=True)).not_to_have_value(before)

    def written(self, label: str) -> str:
        """What a field says, once it says something."""
        field = self.page.get_by_label(label, exact=True)
        expect(field).not_to_have_value("")
        return str(field.input_value())

    def frame_in_space(self) -> None:
        """Draw a frame around all points of the figure in space."""
        self.page.wait_for_function("linked.frames")  # once the server has answered the button
        pane = self.page.locator(".linked.space")
        pane.evaluate("e => e.scrollIntoView({block: 'center'})")
        width, height = pane.evaluate("e => [e.clientWidth, e.clientHeight]")
        pane.hover(position={"x": 0.99 * width, "y": 0.99 * height})  # once it no longer moves
        box = pane.bounding_box()
        self.page.mouse.down()
        self.page.mouse.move(box["x"] + 0.01 * width, box["y"] + 0.01 * height, steps=4)
        self.page.mouse.up()

    def sees(self, text: str | re.Pattern[str]) -> None:
        """Wait until the page shows this."""
        self.page.get_by_text(text).first.wait_for()

    @contextmanager
    def hears(self, text: str) -> Iterator[None]:
        """Inside, the page gives a notice, which it takes back after some seconds."""
        self.page.evaluate(HEARS, text)
        yield
        self.page.wait_for_function("(text) => heard.has(text)", arg=text)

    def sees_stale(self) -> None:
        """Wait until the page says that the result is not of the project as it stands."""
        self.sees(re.compile("The project has changed since this result|Provisional: error"))

    def press_and_see(self, name: str) -> None:
        """Press a button, and wait until the figure over the poses shows other errors."""
        plot = self.page.get_by_label("error over the poses", exact=True)
        before = plot.evaluate(DRAWN)
        self.press(name)
        other = f"([e, before]) => ({DRAWN})(e) !== before"
        self.page.wait_for_function(other, arg=[plot.element_handle(), before])
