"""The report as a reader meets it: opened from the disk by a browser, on desk, phone and paper."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loopcal.report.page import report_html
from loopcal.report.source import read_source
from tests.browser import Seen, chromium, opened
from tests.golden_files import FOLDER

# What every figure has drawn: marks of its kind in the picture itself, and colours in its still.
MARKS = """() => Object.fromEntries([...document.querySelectorAll(".plot")].map((plot) => {
  const svg = plot.querySelectorAll(
    ".scatterlayer .trace .js-line, .scatterlayer .points path, .hm image, .heatmaplayer image");
  const gl = plot.querySelectorAll(".gl-container canvas");
  return [plot.id, {svg: svg.length, gl: gl.length, traces: plot.data.length}];
}))"""
COLOURS = """async () => {
  const found = {};
  for (const image of document.querySelectorAll(".still")) {
    const copy = new Image(); copy.src = image.src; await copy.decode();
    const canvas = document.createElement("canvas");
    canvas.width = copy.naturalWidth; canvas.height = copy.naturalHeight;
    const context = canvas.getContext("2d", {willReadFrequently: true});
    context.drawImage(copy, 0, 0);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height).data;
    let coloured = 0;
    for (let i = 0; i < pixels.length; i += 4) {
      const [r, g, b, a] = pixels.slice(i, i + 4);
      if (a > 100 && Math.max(r, g, b) - Math.min(r, g, b) > 40) coloured += 1;
    }
    found[image.id] = coloured;
  }
  return found;
}"""

SETTLED = """() => [...document.querySelectorAll("section > .side .plot .main-svg")]
  .every((svg) => svg.clientWidth <= innerWidth)"""
INKED = """(ink) => [...document.querySelectorAll('.plot')].every(
  (plot) => plot.layout.font.color === ink)"""
INKS = {"light": "#1c1e21", "dark": "#e6e7ea"}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def both(
    browser: Any, planar: Path, six_axis: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Seen]:
    """Two results side by side, opened once."""
    page = tmp_path_factory.mktemp("both") / "report.html"
    page.write_text(report_html([read_source(planar), read_source(six_axis)]), "utf-8")
    with opened(browser, page, scheme="dark") as seen:
        yield seen


@pytest.fixture(scope="module")
def plane(browser: Any, planar: Path) -> Iterator[Seen]:
    """An arm in the plane, opened once."""
    with opened(browser, planar / "report.html") as seen:
        yield seen


@pytest.fixture(scope="module")
def six(browser: Any, six_axis: Path) -> Iterator[Seen]:
    """An arm in space, opened once."""
    with opened(browser, six_axis / "report.html") as seen:
        yield seen


def test_nothing_leaves_the_machine_and_every_figure_is_drawn(both: Seen) -> None:
    marks = both.page.evaluate(MARKS)
    colours = both.page.evaluate(COLOURS)
    assert both.requests == []
    assert both.complaints == []
    assert both.page.evaluate("document.querySelectorAll('.plot:not([aria-label])').length") == 0
    keys = ("histogram", "residuals", "arrows", "normalised", "drift", "correlations")
    assert set(marks) == {f"r{i}-{key}" for i in (1, 2) for key in keys}
    in_space = {name for name, drawn in marks.items() if drawn["gl"]}
    assert in_space == {"r2-arrows"}
    for name in set(marks) - in_space:
        assert marks[name]["svg"] >= marks[name]["traces"] > 0, name
    assert {name.removesuffix("-still") for name, n in colours.items() if n > 150} == set(marks)


@pytest.mark.parametrize("width", [390, 820, 1440])
def test_it_never_scrolls_sideways(both: Seen, width: int) -> None:
    both.page.set_viewport_size({"width": width, "height": 900})
    both.page.wait_for_function(SETTLED)  # figures follow the width
    assert both.page.evaluate("document.documentElement.scrollWidth") <= width


def test_on_paper_every_figure_is_there(both: Seen) -> None:
    both.page.emulate_media(media="print")
    paper = both.page.pdf()
    sizes = both.page.evaluate(
        "[...document.querySelectorAll('.still')].map((i) => [i.offsetWidth, i.offsetHeight])"
    )
    both.page.emulate_media(media="screen")
    assert both.page.evaluate("document.querySelectorAll('details:not([open])').length") == 0
    assert len(sizes) == 12
    assert all(width > 300 and height > 100 for width, height in sizes)
    assert paper.startswith(b"%PDF")
    assert paper.count(b"/Subtype /Image") >= 1  # the scene in space


def test_it_follows_the_reader_into_the_dark(plane: Seen) -> None:
    for scheme, paper in (("light", "rgb(255, 255, 255)"), ("dark", "rgb(21, 23, 26)")):
        plane.page.emulate_media(color_scheme=scheme)
        shade = plane.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert shade == paper
        plane.page.wait_for_function(INKED, arg=INKS[scheme])  # figures follow a moment later


def test_markup_is_shown_and_never_run(browser: Any, hostile: Path) -> None:
    with opened(browser, hostile / "report.html") as seen:
        title = seen.page.title()
        images = seen.page.evaluate("document.querySelectorAll('img:not(.still)').length")
        scripts = seen.page.evaluate("document.scripts.length")
        figures = seen.page.evaluate("document.querySelectorAll('.plot').length")
        text = seen.page.inner_text("body")
        drawn = seen.page.evaluate(
            "[...document.querySelectorAll('.plot svg text')].map((t) => t.textContent).join(' ')"
        )
    assert title.startswith("<img/src=x")
    assert images == 0
    assert scripts == 2 + figures  # the two that draw, and the data of every figure
    assert seen.requests == []
    assert seen.complaints == []
    for name in ("a</script><script>", "b<img/src=x"):
        assert name in text
        assert name in drawn


def test_a_table_can_be_copied(plane: Seen) -> None:
    plane.page.click("button.copy >> nth=0")
    plane.page.wait_for_selector("button:has-text('copied')")
    copied = plane.page.evaluate("navigator.clipboard.readText()")
    assert [line.split("\t")[0] for line in copied.splitlines()] == [
        "accuracy",
        "nominal",
        "nominal, best placed",
        "calibrated",
        "on poses not used",
        "in regions not used",
        "noise floor",
    ]


def first_screen(seen: Seen, scheme: str) -> bytes:
    """A picture of what a reader sees first."""
    seen.page.set_viewport_size({"width": 1440, "height": 900})
    seen.page.emulate_media(color_scheme=scheme)
    seen.page.evaluate("scrollTo(0, 0)")
    seen.page.wait_for_function(SETTLED)
    seen.page.wait_for_function(INKED, arg=INKS[scheme])
    return bytes(seen.page.screenshot())


SMALL = """async (data) => {
  const image = new Image(); image.src = data; await image.decode();
  const canvas = document.createElement("canvas"); canvas.width = 96; canvas.height = 60;
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high"; context.drawImage(image, 0, 0, 96, 60);
  const pixels = context.getImageData(0, 0, 96, 60).data, grey = [];
  for (let i = 0; i < pixels.length; i += 4)
    grey.push(Math.round((pixels[i] + pixels[i + 1] + pixels[i + 2]) / 3));
  return [canvas.toDataURL(), grey];
}"""


@pytest.mark.parametrize("name", ["planar", "six_axis", "dark", "both"])
def test_the_first_screen_looks_as_it_did(
    name: str, browser: Any, plane: Seen, six: Seen, both: Seen
) -> None:
    """Compared small and grey, so that the fonts of another system do not matter."""
    shown = {"planar": plane, "both": both}.get(name, six)
    taken = first_screen(shown, "dark" if name in ("dark", "both") else "light")
    blank = browser.new_page()
    picture, grey = blank.evaluate(SMALL, address(taken))
    kept = FOLDER / f"report-{name}.png"
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        kept.write_bytes(base64.b64decode(picture.split(",")[1]))
    _, before = blank.evaluate(SMALL, address(kept.read_bytes()))
    blank.close()
    assert np.abs(np.array(grey, dtype=float) - np.array(before)).mean() < 8.0


def address(picture: bytes) -> str:
    """A picture as an address."""
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def test_the_switch_shows_the_machine_before_the_calibration(six: Seen) -> None:
    shown = "document.getElementById('r1-arrows').data.map((t) => t.name + t.visible).join()"
    after = six.page.evaluate(shown)
    six.page.click("#r1-arrows .updatemenu-button >> nth=0")
    six.page.wait_for_function(f"() => {shown} !== {after!r}")
    before = six.page.evaluate(shown)
    assert "mm aftertrue" in after
    assert "mm aftertrue" not in before
    assert "mm beforetrue" in before


def test_experts_matter_is_folded_away_and_its_figures_fit_once_unfolded(six: Seen) -> None:
    assert six.page.locator("#experts details").count() >= 5
    assert six.page.locator("#experts details[open]").count() == 0
    six.page.click("#experts summary:has-text('Sensors')")
    six.page.wait_for_function(
        """() => { const plot = document.getElementById("r1-drift");
        return plot.querySelector(".main-svg").clientWidth === plot.clientWidth; }"""
    )
