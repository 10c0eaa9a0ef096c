"""The path from two files to an exported URDF without a pointer, with the focus in sight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.app.pointing import Hand, new_page
from tests.app.serving import Served
from tests.reference.dh_arm import SLIPPED

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "slipped_reflector"
FOCUS = """
() => {
  const e = document.activeElement;
  const name = e.getAttribute('aria-label') ?? e.labels?.[0]?.innerText ?? e.innerText ?? '';
  const seen = e.closest('.q-field--focused') ?? e;
  const style = getComputedStyle(seen), box = seen.getBoundingClientRect();
  const marked = seen !== e || style.outlineStyle !== 'none' || style.boxShadow !== 'none'
    || e.querySelector('.q-focus-helper') !== null;
  return {name: name.trim(), marked, inside: box.bottom > 0 && box.top < innerHeight};
}
"""
"""What has the focus, and whether an eye sees so."""


class Keys(Hand):
    """The same user without a hand at a pointer."""

    def reach(self, name: str) -> None:
        """Tab until the focus is on what is named so."""
        for _ in range(120):
            self.page.keyboard.press("Tab")
            found = self.page.evaluate(FOCUS)
            if found["name"].startswith(name):
                assert found["marked"], f"the focus on {name} is not seen"
                assert found["inside"], f"{name} is out of the window"
                return
        raise AssertionError(f"Tab does not reach {name}")

    def press(self, name: Any) -> None:
        """Press a button."""
        self.reach(name)
        self.page.keyboard.press("Enter")

    def step(self, name: str) -> None:
        """Go to a step."""
        self.press(f"{name}:")
        self.page.get_by_role("heading", name=name, exact=True, level=1).wait_for()

    def drop(self, label: str, *files: Path) -> None:
        """Hand in files."""
        with self.page.expect_file_chooser() as chooser:
            self.press(f"{label}: Choose files")
        chooser.value.set_files([str(file) for file in files])

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        self.reach(label)
        self.page.keyboard.press("Enter")
        options = self.page.get_by_role("option")
        options.first.wait_for()
        focused = self.page.locator("[role=option].q-manual-focusable--focused")
        for _ in range(20):  # the list begins where it was left, and behind its end there is none
            self.page.keyboard.press("ArrowDown")
            if any(text.startswith(option) for text in focused.all_inner_texts()):
                self.page.keyboard.press("Enter")
                return
        raise AssertionError(f"the arrows do not reach {option}")

    def type(self, label: str, text: str) -> None:
        """Write into a field."""
        self.reach(label)
        self.page.keyboard.press("Control+a")
        self.page.keyboard.type(text)


def test_from_two_files_to_a_urdf_by_keyboard(browser: Any, cell: tuple[Served, Path]) -> None:
    served, folder = cell
    page = new_page(browser, (820, 1180))
    page.goto(served.address)
    keys = Keys(page, folder)
    keys.drop("Drop the URDF here", EXAMPLE / "arm.urdf")
    keys.sees("Go on with the step Data")
    keys.step("Data")
    keys.drop("Drop the files of readings here", EXAMPLE / "poses.csv")
    page.get_by_role("heading", name="Files of readings").wait_for()
    keys.run("Recognise")
    keys.sees("60 poses")
    keys.step("Fit")
    keys.choose("Method", "least-squares")
    keys.run("Calibrate", "exit code 4")
    keys.step("Diagnose")
    keys.reach("From pose: one pose earlier")
    keys.type("From pose", str(SLIPPED))  # the field follows its button
    page.keyboard.press("Enter")
    keys.sees("30 of 60 poses selected")
    keys.press("Reflector moved here")
    keys.sees_stale()
    keys.step("Fit")
    keys.choose("Method", "implicit-loop")
    keys.run("Calibrate")
    keys.step("Deploy")
    keys.choose("Your own file", "arm.urdf")
    keys.run("Preview")
    keys.sees("Lines that change are marked")
    keys.run("Write")
    page.close()
    assert (folder / "project-result/export/arm.urdf").exists()
