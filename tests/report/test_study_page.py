"""The page of a study: what it says is what was drawn, and it is drawn without any network."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from loopcal.execution.executor import InProcess
from loopcal.report.study_page import PAGE, study_html, words, write_study_page
from loopcal.studies.run import StudyDone, run_study
from tests.browser import chromium, opened

STUDY = """
schema = 1
title = "Two <b>joints</b>"
draws = 40
seed = 3

[mechanism]
type = "planar-two-link"

[noise]
xPyP = { sd = 0.1, unit = "mm" }
"phi*" = { sd = 1, unit = "mrad" }

[simulation.ranges]
phi2 = { from = 0, to = 90, step = 15, unit = "deg" }
phi3 = { from = 0, to = 90, step = 15, unit = "deg" }

[[methods]]
method = "implicit-loop"

[[methods]]
method = "least-squares"

[[scenarios]]
name = "third <i>joint</i> poor"
noise = { phi3 = { sd = 100, unit = "mrad" } }

[[scenarios]]
name = "exact"
[scenarios.simulation.noise]
xPyP = 0
"phi*" = 0
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyDone:
    folder = tmp_path_factory.mktemp("study")
    file = folder / "joints.toml"
    file.write_text(STUDY, "utf-8")
    made = run_study(file, executor=InProcess(), out=folder / "out")
    write_study_page(made)
    return made


def test_words_say_where_a_method_helps_and_where_not(done: StudyDone) -> None:
    poor, exact = (words(scenario) for scenario in done.tables.scenarios)
    assert any("implicit-loop has smaller rms errors than least-squares" in w for w in poor)
    assert any("Intervals of least-squares too narrow" in w for w in poor)
    assert exact == ["Every error is rounding, below 1e-12 m or rad: all methods are right."]


def test_the_page_holds_the_numbers_of_the_tables_and_shows_markup_as_text(done: StudyDone) -> None:
    page = study_html(done)
    assert "Two &lt;b&gt;joints&lt;/b&gt;" in page
    assert "<i>joint</i>" not in page
    spread = done.tables.scenarios[0].methods[1].spreads[3]
    assert spread.name == "l3"
    row = re.search(r">l3</th><td>um</td><td>([^<]+)</td>", page.split("least-squares: 40 of")[1])
    assert row is not None
    assert float(row[1]) == pytest.approx(1e6 * spread.bias, rel=1e-3)
    assert len(page) < 7_000_000


def test_a_page_is_the_same_from_the_draws_on_disk(done: StudyDone) -> None:
    again = run_study(done.study.path or "", executor=InProcess(), out=done.folder)
    assert study_html(again) == (done.folder / PAGE).read_text("utf-8")


def test_a_browser_draws_it_silently(done: StudyDone) -> None:
    with chromium() as browser, opened(browser, Path(done.folder / PAGE), width=390) as seen:
        assert seen.requests == []
        assert seen.complaints == []
        drawn = seen.page.evaluate(
            "[...document.querySelectorAll('.plot')].map(p => p.querySelectorAll("
            "'.scatterlayer .trace path').length)"
        )
        assert len(drawn) >= 6
        assert min(drawn) > 0
        for width in (390, 1440):
            seen.page.set_viewport_size({"width": width, "height": 900})
            seen.page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
