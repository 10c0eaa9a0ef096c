"""What a user does on a page is never lost to what the server says meanwhile.

Every update that could lose it comes late here: the server has drawn, the page does not know yet.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from loopcal.companions.app import words
from loopcal.companions.app.project_folder import LOG
from tests.app.pointing import Hand, new_page
from tests.app.serving import Served
from tests.app.test_in_a_browser import STEPS, select
from tests.app.wire import Wire
from tests.browser import expect, until

FIELDS = """
() => [...document.querySelectorAll('.q-page .q-field input')]
  .filter(e => !e.readOnly && e.getAttribute('role') !== 'combobox' && e.offsetParent)
  .map(e => [e.getAttribute('aria-label'), e.type])
"""
"""Labels and kinds of the fields that can be written in."""
RANGE = {"from": -30, "to": 40, "unit": "deg"}
HERE = "() => [document.activeElement.getAttribute('aria-label'), document.activeElement.value]"


@pytest.fixture(scope="module")
def held_page(served: Served, browser: Any, hostile: Path) -> Iterator[tuple[Hand, Wire]]:
    """A page whose server can be held back, opened once."""
    page = new_page(browser)
    wire = Wire(page)
    page.goto(served.address)
    yield Hand(page, hostile), wire
    page.close()


@pytest.fixture
def late(held_page: tuple[Hand, Wire]) -> Iterator[tuple[Hand, Wire]]:
    """The same at the first step; the folder is afterwards as it was."""
    hand, _ = held_page
    kept = {name: (hand.folder / name).read_bytes() for name in ("project.toml", LOG)}
    yield held_page
    hand.step(STEPS[0])
    for name, content in kept.items():
        (hand.folder / name).write_bytes(content)
    for other in hand.folder.glob("late-*"):
        other.unlink()


def changed_by_another(hand: Hand, wire: Wire, number: int) -> None:
    """The server has drawn a change of the folder that the page does not know."""
    wire.hold()
    (hand.folder / f"late-{number}.csv").write_text("a\n1\n", "utf-8")
    wire.wait("notify")


def open_record(page: Any) -> None:
    """Unfold what is stated of the record, which may be open already."""
    operator = page.get_by_label(words.STATED["operator"], exact=True)
    if not operator.is_visible():
        page.get_by_text(f"of {len(words.STATED)} stated").click()
    operator.wait_for()


def heard(hand: Hand, wire: Wire) -> None:
    """The page hears all of it, and is drawn anew."""
    hand.page.evaluate("document.querySelector('.q-page [role=heading]').id = 'before'")
    wire.release()
    hand.page.locator("#before").wait_for(state="detached")


def test_what_is_being_written_stands_wherever_the_page_is_drawn_anew(
    late: tuple[Hand, Wire],
) -> None:
    hand, wire = late
    page, number = hand.page, 0
    for step in STEPS:
        hand.step(step)
        if step == "Deploy":
            open_record(page)
        for label, kind in page.evaluate(FIELDS) if step != "Diagnose" else ():
            number += 1
            first, second = ("7", "3") if kind == "number" else ("wri", "tten")
            page.get_by_label(label, exact=True).fill(first)
            changed_by_another(hand, wire, number)
            page.keyboard.type(second)
            heard(hand, wire)
            assert page.evaluate(HERE) == [label, first + second], step
            page.keyboard.type("5")
            assert page.evaluate(HERE) == [label, first + second + "5"], step
            page.get_by_label(label, exact=True).fill("")
    assert number > 15


def test_a_late_selection_overwrites_no_end_that_is_being_written(
    late: tuple[Hand, Wire],
) -> None:
    hand, wire = late
    page = hand.page
    hand.step("Diagnose")
    select(page, 30)
    hand.sees("30 of 49 poses selected")
    end = page.get_by_label("To pose", exact=True)
    ids = hand.written("To pose").rstrip("0123456789")
    end.fill(f"{ids}6")
    wire.hold()
    select(page, 20)  # what it says of the ends comes late
    wire.wait("update")
    page.keyboard.press("Enter")
    wire.release()
    hand.sees("6 of 49 poses selected")
    assert page.evaluate(HERE) == ["To pose", f"{ids}6"]
    page.keyboard.press("Tab")
    expect(end).to_have_value(f"{ids}6")


def test_a_field_that_is_left_untouched_shows_what_came_meanwhile(
    late: tuple[Hand, Wire],
) -> None:
    hand, _ = late
    page = hand.page
    hand.step("Diagnose")
    select(page, 30)
    hand.sees("30 of 49 poses selected")
    end = page.get_by_label("To pose", exact=True)
    before = hand.written("To pose")
    end.focus()
    select(page, 20)
    hand.sees("20 of 49 poses selected")
    assert end.input_value() == before
    end.blur()
    expect(end).to_have_value(re.compile("20$"))


@pytest.mark.parametrize(
    ("step", "label", "said", "stated", "leaves"),
    [
        (
            "Fit",
            words.TOLERANCE,
            "0.25",
            {"verdict": {"tolerance": {"value": 0.25, "unit": "mm"}}},
            "Tab",
        ),
        (
            "Deploy",
            words.STATED["operator"],
            "A. Reader",
            {"record": {"operator": "A. Reader"}},
            "Enter",
        ),
        ("Plan", "phi2 to", "40", {"plan": {"ranges": {"phi2": RANGE}}}, "Tab"),
    ],
)
def test_what_was_written_is_stated_also_where_the_field_is_gone_by_then(
    late: tuple[Hand, Wire], step: str, label: str, said: str, stated: dict[str, Any], leaves: str
) -> None:
    hand, wire = late
    page, project = hand.page, hand.folder / "project.toml"
    hand.step(step)
    if step == "Deploy":
        open_record(page)
    if step == "Plan":
        page.get_by_label("phi2 from", exact=True).fill("-30")
        page.keyboard.press("Tab")
    page.get_by_label(label, exact=True).fill(said)
    changed_by_another(hand, wire, 0)
    page.keyboard.press(leaves)
    until(page, lambda: stated.items() <= tomllib.loads(project.read_text("utf-8")).items())
    heard(hand, wire)
    expect(page.get_by_label(label, exact=True)).to_have_value(said)


@pytest.mark.parametrize(
    ("step", "label"), [("Plan", words.POSES_TO_MEASURE), ("History", words.EVENT)]
)
def test_what_is_selected_stays_so_and_is_written_over(
    late: tuple[Hand, Wire], step: str, label: str
) -> None:
    hand, wire = late
    hand.step(step)
    field = hand.page.get_by_label(label, exact=True)
    field.fill("30")
    hand.page.keyboard.press("Tab")
    hand.page.keyboard.press("Shift+Tab")
    changed_by_another(hand, wire, 0)
    heard(hand, wire)
    hand.page.keyboard.type("6")
    assert hand.page.evaluate(HERE) == [label, "6"]
    field.fill("")


def clicked_late(hand: Hand, wire: Wire) -> None:
    """Click on a button in place of which another one is drawn already, unknown to the page."""
    hand.press(words.ADD_THIS_EVENT)
    heard(hand, wire)


def pressed_meanwhile(hand: Hand, wire: Wire) -> None:
    """Press a mouse button; the page is drawn anew before it is let go."""
    hand.page.get_by_role("button", name=words.ADD_THIS_EVENT).hover()
    hand.page.mouse.down()
    heard(hand, wire)
    hand.page.mouse.up()


def by_key(hand: Hand, wire: Wire) -> None:
    """Press a key on a button that is drawn anew before, and again before the key is let go."""
    hand.page.get_by_role("button", name=words.ADD_THIS_EVENT).focus()
    heard(hand, wire)
    changed_by_another(hand, wire, 1)
    hand.page.keyboard.down("Enter")
    heard(hand, wire)
    hand.page.keyboard.up("Enter")


@pytest.mark.parametrize("press", [clicked_late, pressed_meanwhile, by_key])
def test_a_press_on_what_is_gone_by_then_counts_once(
    late: tuple[Hand, Wire], press: Callable[[Hand, Wire], None]
) -> None:
    hand, wire = late
    page = hand.page
    hand.step("History")
    page.get_by_label(words.EVENT).fill("new belt")
    changed_by_another(hand, wire, 0)
    before = int(page.locator(".run").get_attribute("data-finished"))
    log = hand.folder / LOG
    begun = log.read_text("utf-8").count('"begun"')  # other tests have run commands there
    press(hand, wire)
    page.locator(f'.run[data-finished="{before + 1}"]').wait_for(state="attached")
    assert log.read_text("utf-8").count('"begun"') == begun + 1
    for path in (hand.folder / "machine.history").iterdir():
        path.unlink()
    (hand.folder / "machine.history").rmdir()
    (hand.folder / "machine.history.html").unlink()


def test_an_open_list_stays_open_and_takes_the_choice(late: tuple[Hand, Wire]) -> None:
    hand, wire = late
    page = hand.page
    hand.step("Plan")
    page.get_by_label(words.BEST_FOR, exact=True).first.click()
    page.get_by_role("option").first.wait_for()
    changed_by_another(hand, wire, 0)
    heard(hand, wire)
    page.get_by_role("option", name=words.CRITERIA["G"]).click()
    hand.sees(re.compile("--criterion G"))
