"""One selection in all figures: by brushing, by naming ends, of more than is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from loopcal.companions.app import words
from loopcal.companions.app.beside import SIZE
from loopcal.companions.app.pictures import Errors
from loopcal.report.source import read_source
from tests.app.pointing import AT_REST, Hand, new_page
from tests.app.serving import Served

MARKED = """
() => [...document.querySelectorAll('.linked')].map(figure => {
  if (figure.space) return figure.space.chosen.size;
  const some = figure.data[0].selectedpoints?.length ?? 0;
  const drawn = [...figure.querySelectorAll('.trace:first-child path.point')];
  return Math.max(some, drawn.filter(e => e.style.fill === 'rgb(213, 94, 0)').length);
})
"""
"""Poses that each figure marks."""


def test_every_brush_marks_all_figures_also_inside_the_frame_of_the_last(
    served: Served, browser: Any
) -> None:
    page = new_page(browser, reduced_motion="no-preference")
    page.goto(served.address)
    hand = Hand(page)
    hand.step("Diagnose")
    for begin, end in ((0.5, 20.5), (5.5, 12.5), (8.5, 30.5)):
        hand.brush("error over the poses", begin, end)
        count = round(end - begin)
        hand.sees(f"{count} of 49 poses selected")
        page.wait_for_function(f"({MARKED})().every(marked => marked === {count})")
    for label, pose in (("From pose", 3), ("To pose", 6)):
        ids = hand.written(label).rstrip("0123456789")
        page.get_by_label(label, exact=True).fill(f"{ids}{pose}")
    page.get_by_label("To pose", exact=True).press("Enter")
    hand.sees("4 of 49 poses selected")
    page.wait_for_function(f"({MARKED})().every(marked => marked === 4)")
    page.set_viewport_size({"width": 1000, "height": 800})
    page.get_by_label("error over the poses", exact=True).evaluate(AT_REST)  # drawn again
    page.wait_for_function(f"({MARKED})().every(marked => marked === 4)")
    with hand.hears(words.NO_SUCH_POSE.format(pose="none")):
        page.get_by_label("To pose", exact=True).fill("none")
        page.get_by_label("To pose", exact=True).press("Enter")
    hand.sees("4 of 49 poses selected")
    page.close()


def test_a_frame_selects_also_the_poses_that_are_not_drawn(
    hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = read_source(hostile / "project-result")
    whole = Errors.of(source)
    assert whole is not None
    frame = {"x": [10.5, 20.5], "y": [0.0, float(whole.size.max())]}
    assert whole.framed((whole.numbers, whole.size), frame) is None  # plotly has named them all
    monkeypatch.setattr("loopcal.companions.app.pictures.MOST", 12)
    few = Errors.of(source, selected=range(5, 49))
    assert few is not None
    assert len(few.drawn) <= 12
    assert few.framed((few.numbers, few.shown[SIZE]), frame) == list(range(10, 20))
    (trace,) = few.over_poses()["data"]
    assert [few.drawn[i] for i in trace["selectedpoints"]] == [i for i in few.drawn if i >= 5]
