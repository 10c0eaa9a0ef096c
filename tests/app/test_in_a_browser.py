"""The page in Chromium: it opens, asks nobody else, fits its window and shows names as text."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from loopcal.companions.app import words
from tests.app.conftest import SCRIPT
from tests.app.contrast import violations, weak_texts
from tests.app.pointing import Hand, new_page
from tests.app.serving import Served
from tests.browser import PATIENCE, Seen, expect, until
from tests.files.hostile.generated import workbook_bomb

STEPS = ("Robot", "Data", "Plan", "Check", "Fit", "Diagnose", "Validate", "Deploy", "History")
HARMLESS = ("Resize must be passed a displayed plot div element", "Plotly is not loaded yet")
"""What plotly says where a step is left before its figures have been drawn."""
SIZES = {"desktop": (1440, 900), "tablet": (820, 1180), "phone": (390, 844)}
SETTLED = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Until the page has been laid out, and its scripts have seen that."""
MADE_OF_NAMES = "document.querySelectorAll('img[src=\"x\"]').length + (window.hit ?? 0)"


SPACE = Path(words.__file__).parent / "scripts" / "space.js"
BOXED = """async (code) => {
  const url = URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
  const { methods } = (await import(url)).default;
  const figure = { traces: [{ at: [[0, 1], [0, 0], [0, 2]] }], fit() {} };
  methods.boxed.call(figure);
  return [figure.low, figure.high];
}"""
"""The ends of the axes of a figure in space whose points lie in a plane."""


def opened(browser: Any, served: Served, size: str = "desktop", scheme: str = "light") -> Seen:
    """A page of the app, and what it asked for elsewhere and complained about."""
    seen = Seen(new_page(browser, SIZES[size], color_scheme=scheme))
    own = (served.address, served.address.replace("http", "ws"), "data:", "blob:")

    def asked(request: Any) -> None:
        if not request.url.startswith(own):
            seen.requests.append(request.url)

    def said(message: Any) -> None:
        if message.type == "error" and not message.text.startswith(HARMLESS):
            seen.complaints.append(message.text)

    def thrown(error: Any) -> None:
        if not str(error).startswith(HARMLESS):
            seen.complaints.append(str(error))

    seen.page.on("request", asked)
    seen.page.on("console", said)
    seen.page.on("pageerror", thrown)
    seen.page.goto(served.address)
    return seen


def select(page: Any, count: int) -> None:
    """Select the first poses, as brushing does."""
    plot = page.get_by_label("error over the poses", exact=True)
    plot.locator(".nsewdrag").first.wait_for()
    points = [{"customdata": i} for i in range(count)]
    plot.evaluate("(plot, points) => plot.emit('plotly_selected', {points})", points)


@pytest.mark.parametrize(
    ("size", "scheme"), [("desktop", "light"), ("tablet", "dark"), ("phone", "light")]
)
def test_every_step_opens_in_its_window_with_names_as_text_and_contrast(
    served: Served, browser: Any, size: str, scheme: str
) -> None:
    seen = opened(browser, served, size, scheme)
    for name in STEPS:
        Hand(seen.page).step(name)
        wide = seen.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        seen.page.evaluate(SETTLED)
        assert wide <= 0, f"{name} is {wide} pixels wider than the window"
        assert seen.page.evaluate(MADE_OF_NAMES) == 0, name
        assert weak_texts(seen.page) == [], name
        if size != "tablet":  # whose parts are those of the desktop
            assert violations(seen.page) == [], name
        assert "This is a fault of loopcal" not in seen.page.inner_text("body"), name
    expect(seen.page.locator("body")).to_contain_text(SCRIPT)  # the log shows it
    if size == "desktop":  # addresses know of no size
        assert_addresses_are_kept(seen.page, served.address)
    seen.page.close()
    assert seen.complaints == []
    assert seen.requests == []


SCROLLED = "() => Math.abs(scrollY - 150) < 2"


def test_an_arm_that_lies_in_a_plane_has_room_in_every_direction(browser: Any) -> None:
    """Axes without extent would leave the figure in space empty."""
    page = new_page(browser)
    low, high = page.evaluate(BOXED, SPACE.read_text("utf-8"))
    assert (low, high) == ([0.0, -0.4, 0.0], [1.0, 0.4, 2.0])
    page.close()


def test_a_figure_that_left_the_page_draws_no_more(served: Served, browser: Any) -> None:
    page = opened(browser, served).page
    Hand(page).step("Diagnose")
    page.locator(".js-plotly-plot").first.wait_for()
    page.evaluate("window.figure = document.querySelector('.js-plotly-plot')")
    Hand(page).step("Deploy")
    until(page, lambda: page.evaluate("window.figure.data === undefined"))
    page.close()


def test_an_address_of_before_the_user_went_back_is_not_taken(served: Served, browser: Any) -> None:
    """Else a slow server would put the step that was left behind the user again."""
    page = opened(browser, served).page
    for step in ("Fit", "Check"):
        Hand(page).step(step)
        page.wait_for_function("(end) => location.pathname === end", arg=f"/{step.lower()}")
    page.go_back()
    page.wait_for_function("() => addresses.went === 1")
    page.evaluate("addresses.show('/check', 'late', 0)")
    assert page.evaluate("location.pathname") == "/fit"
    heading = page.get_by_role("heading", name="Fit", exact=True, level=1)
    heading.wait_for()
    page.close()


def assert_addresses_are_kept(page: Any, address: str) -> None:
    """Each step and selection has an address; back, reload and place are the browser's."""

    def heading(name: str) -> Any:
        return page.get_by_role("heading", name=name, exact=True, level=1)

    page.wait_for_function("(url) => location.href === url", arg=f"{address}/history")
    Hand(page).step("Fit")
    page.wait_for_function("() => addresses.wanted === null")  # it scrolls to the top by itself
    page.evaluate("scrollTo(0, 150)")
    page.wait_for_function("() => addresses.places['/fit'] === 150")
    Hand(page).step("Check")
    # the heading may be there ahead of the address and of the place
    page.wait_for_function("(url) => location.href === url", arg=f"{address}/check")
    page.wait_for_function("() => scrollY === 0")
    page.go_back()
    heading("Fit").wait_for()
    page.wait_for_function(SCROLLED)
    page.reload()
    heading("Fit").wait_for()
    page.wait_for_function(SCROLLED)
    page.go_back()
    heading("History").wait_for()
    Hand(page).step("Diagnose")
    select(page, 3)
    page.wait_for_function("() => location.search.startsWith('?poses=')")
    page.goto(page.url)  # as from a bookmark
    Hand(page).sees("3 of 49 poses selected")
    page.goto(f"{address}/history?run=1")
    page.get_by_role("heading", level=2).filter(has_text=SCRIPT).wait_for()


def test_an_error_and_a_name_handed_in_are_shown_as_text(
    served: Served, browser: Any, hostile: Path
) -> None:
    """Also the page follows a change of the folder by another program."""
    seen = opened(browser, served)
    project = hostile / "project.toml"
    before = project.read_text("utf-8")
    try:
        project.write_text(f'"{SCRIPT}" = 1\n{before}', "utf-8")
        seen.page.get_by_text("unknown key").first.wait_for()
        assert seen.page.evaluate(MADE_OF_NAMES) == 0
    finally:
        project.write_text(before, "utf-8")
    expect(seen.page.get_by_text("unknown key")).to_have_count(0)  # drawn anew, it takes files
    Hand(seen.page).step("Data")
    name = f"{SCRIPT}{SCRIPT}.txt"
    file = {"name": name, "mimeType": "text/plain", "buffer": b"1"}
    seen.page.set_input_files('input[type="file"] >> nth=0', [file])
    Hand(seen.page).step("Deploy")
    seen.page.get_by_text(name).first.wait_for()
    assert seen.page.evaluate(MADE_OF_NAMES) == 0
    (hostile / name).unlink()
    seen.page.close()


def test_hostile_files_handed_in_are_refused_in_words(
    served: Served, browser: Any, hostile: Path
) -> None:
    contents = {"bomb.xlsx": workbook_bomb(400 << 20), "nul.csv": b"pose,phi2\0,x\n1,\0\0,3\n"}
    hand = Hand(opened(browser, served).page)
    box = hand.page.locator(".q-uploader", has_text="Drop readings of another day here")
    for name, content in contents.items():
        hand.step("Validate")
        file = {"name": name, "mimeType": "application/octet-stream", "buffer": content}
        with hand.page.expect_response(lambda answer: answer.request.method == "POST"):
            box.locator("input[type=file]").set_input_files([file])
        hand.step("Deploy")
        hand.sees(re.compile(rf"^{name} \("))
    hand.step("Validate")
    for name in contents:
        hand.choose("Readings", name)
        hand.run("Verify", "an input was wrong")
        expect(hand.page.locator(".run")).to_contain_text(name)
        assert "Traceback" not in hand.page.locator(".run").inner_text()
    hand.page.close()
    for name in contents:
        (hostile / name).unlink()


def test_three_pages_keep_what_is_theirs_and_see_what_others_change(
    served: Served, browser: Any, hostile: Path
) -> None:
    project = hostile / "project.toml"
    before = project.read_text("utf-8")
    tabs = browser.new_context(viewport={"width": 1440, "height": 900}, reduced_motion="reduce")
    tabs.set_default_timeout(PATIENCE)
    pages = [tabs.new_page() for _ in range(3)]
    first, second, third = map(Hand, pages)
    for page in pages:
        page.goto(served.address)
    third.step("History")
    third.page.get_by_label(words.EVENT).fill("new belt")
    for count, hand in ((10, first), (20, second)):
        hand.step("Diagnose")
        select(hand.page, count)
    for count, hand in ((10, first), (20, second)):
        hand.sees(f"{count} of 49 poses selected")
    with ExitStack() as notices:
        for hand in (second, third):
            notices.enter_context(hand.hears(words.CHANGED))
        first.press("Exclude")
    assert project.read_text("utf-8") != before
    second.sees("10 of 39 poses selected")  # of the others none is there any more
    expect(third.page.get_by_label(words.EVENT)).to_have_value("new belt")
    with second.hears(words.CHANGED):
        third.press(re.compile("^Undo"))
        third.sees("(undone)")
    assert project.read_text("utf-8") == before
    tabs.close()
