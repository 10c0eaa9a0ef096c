"""The page of a verification: what changed, beside what would have been seen."""

from __future__ import annotations

from dataclasses import replace

import plotly.graph_objects as go

import loopcal as lc
from loopcal.report.verification_page import change_figures, verification_html
from tests.reference.simulated import planar_arm
from tests.statistics.test_comparison import elsewhere, sds_of


def test_a_page_shows_the_change_and_the_smallest_ones() -> None:
    arm = planar_arm(40)
    noise = lc.Noise(sds_of(arm))
    result = lc.calibrate(arm.truth, arm.read(sds_of(arm), 1), noise=noise, method="implicit-loop")
    day = elsewhere(arm, 1001, 30).read(sds_of(arm), 5001)
    found = lc.verify(result, day.with_readings({"phi3": day["phi3"] - 0.02}))
    assert found.changes is not None
    figures = {figure.key: figure for figure in change_figures(found.changes)}
    assert {"angles", "lengths"} <= set(figures)
    bars, points = figures["angles"].data
    assert list(points["y"]) == [found.changes.found[0].words.split(" moved")[0]]
    assert abs(points["x"][0] - 1.146) < 0.3  # [deg]
    assert all(smallest > 0.0 for smallest in bars["x"])
    for figure in figures.values():
        go.Figure({"data": list(figure.data), "layout": dict(figure.layout)})
    page = verification_html(replace(found, poses=("<b>",)), "<i>arm", "<u>.csv")
    assert "<i>arm" not in page
    assert "Changes in deg" in page
