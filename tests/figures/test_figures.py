"""Figures as data: what plotly accepts, what is thinned and says so, what is drawn of numbers."""

from __future__ import annotations

import json

import numpy as np
import plotly.graph_objects as go
import pytest

from loopcal.figures.figure import COLOURS, Figure, colours, numbers, thinned
from loopcal.figures.residuals import (
    correlations,
    distance_histogram,
    drift,
    normalised,
    over_poses,
)
from loopcal.figures.space import Machine, arrows

RANDOM = np.random.default_rng(3)
IDS = [str(i) for i in range(50)]
SERIES = {"x": RANDOM.standard_normal(50), "y<b>": RANDOM.standard_normal(50)}
SHADES = colours(SERIES)
POINTS, STEPS = RANDOM.standard_normal((3, 50)), 1e-3 * RANDOM.standard_normal((3, 50))
BOTH = {"before": 5.0 * STEPS, "after": STEPS}


def every_figure() -> list[Figure]:
    found = [
        distance_histogram(np.abs(SERIES["x"]), 0.01 * np.abs(SERIES["x"]), "mm"),
        over_poses(SERIES, SERIES, IDS, "mm", "What"),
        over_poses(SERIES, {}, IDS, "mm", "What"),
        arrows(POINTS, BOTH, Machine(POINTS[:, :4].T, ("a", "b<i>", "", "end")), IDS, "mm", 1e-3),
        arrows(POINTS[:2], {"after": STEPS[:2]}, None, IDS, "mm", 1e-3),
        normalised(SERIES, SHADES),
        drift(SERIES, IDS, SHADES),
        correlations(np.cov(RANDOM.standard_normal((3, 20))), ["a", "b", "c<i>"]),
    ]
    assert all(found)
    return [figure for figure in found if figure is not None]


FIGURES = every_figure()


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.key)
def test_plotly_accepts_it_and_it_has_words(figure: Figure) -> None:
    # plotly's own check of every attribute; ours are plain data because this takes long
    made = go.Figure(data=list(figure.data), layout=dict(figure.layout))
    assert len(made.data) == len(figure.data)
    assert len(figure.caption) > 40
    assert len(figure.label) > 20


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.key)
def test_its_json_can_end_no_script(figure: Figure) -> None:
    text = figure.json()
    assert not set("<>&") & set(text)
    assert json.loads(text)["layout"] == {**figure.layout, "height": figure.height}


def test_plotly_gets_no_markup_of_users() -> None:
    names = [trace["name"] for figure in FIGURES for trace in figure.data if "name" in trace]
    assert "y&lt;b&gt;" in names
    assert not [name for name in names if "<" in name]


def test_nothing_is_thinned_below_the_limit() -> None:
    found = thinned(np.array([1.0, np.nan, 3.0]), 10)
    assert found.index.tolist() == [0, 2]
    assert found.words == ""


def test_thinning_keeps_the_largest_and_says_so() -> None:
    sizes = RANDOM.random(100_000)
    sizes[[17, 54_321]] = -9.0, 7.0
    found = thinned(sizes, 2000)
    assert found.index.size <= 2000
    assert {17, 54_321, 0, 99_999} <= set(found.index.tolist())
    assert "100,000 poses" in found.words


def test_the_histogram_counts_every_pose() -> None:
    before, after = RANDOM.random(100_000), 0.5 * RANDOM.random(100_000)
    figure = distance_histogram(before, after, "mm")
    assert figure is not None
    for trace in figure.data:
        assert sum(trace["y"][:-1]) == 100_000  # the last step only closes the outline


def test_arrows_are_as_long_as_they_say() -> None:
    points, steps = np.zeros((2, 2)), np.array([[1e-3, 2e-3], [0.0, 0.0]])
    points[:, 1] = 1.0
    figure = arrows(points, {"after": steps}, None, IDS, "mm", 1e-3)
    assert figure is not None
    scale = float(figure.caption.split(" times")[0].rsplit(" ", 1)[1].replace(",", ""))
    shafts = [t["x"][1] - t["x"][0] for t in figure.data if t["mode"] == "lines"]
    assert shafts == pytest.approx([1e-3 * scale, 2e-3 * scale], rel=1e-5)


def test_correlations_are_those_of_the_covariance() -> None:
    figure = correlations(np.array([[4.0, -1.0], [-1.0, 1.0]]), ["a", "b"])
    assert figure is not None
    assert figure.data[0]["z"] == [[1.0, -0.5], [-0.5, 1.0]]
    assert "-0.500 between a and b" in figure.label
    assert correlations(np.array([[4.0]]), ["a"]) is None


def test_unknown_numbers_are_gaps() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf])) == [1.23457, None, None]
    assert normalised({"x": np.full(3, np.nan)}, SHADES) is None
    assert drift({}, [], {}) is None
    assert over_poses({}, {}, [], "mm", "What") is None
    assert arrows(POINTS, {"after": np.full((3, 50), np.nan)}, None, IDS, "mm", 1e-3) is None


def test_a_name_has_one_colour_in_every_figure_and_neighbours_differ_without_green_cones() -> None:
    shades = colours(["a", "b", "a", "c"])
    assert shades == dict(zip("abc", COLOURS, strict=False))
    # Machado et al. (2009), deuteranopia, in linear light
    seen = np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]])
    codes = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in COLOURS]) / 255.0
    found = np.clip(codes**2.2 @ seen.T, 0.0, 1.0) ** (1.0 / 2.2)
    apart = np.linalg.norm(found[:, None] - found[None], axis=2) + np.eye(len(COLOURS))
    assert apart[:6, :6].min() > 0.15
    assert apart.min() > 0.06


def test_the_labels_of_88_parameters_have_room() -> None:
    figure = correlations(np.eye(88), [f"p_{i}" for i in range(88)])
    assert figure is not None
    assert figure.layout["height"] >= 88 * 11
    assert figure.least_width >= 88 * 11


def test_every_sensor_has_a_panel_of_its_own() -> None:
    nine = {f"s{i}": RANDOM.standard_normal(50) for i in range(9)}
    figure = normalised(nine, colours(nine))
    assert figure is not None
    assert len({(t["xaxis"], t["yaxis"]) for t in figure.data}) == 9


def test_ticks_are_never_thousands_of_units() -> None:
    for figure in FIGURES:
        axes = [v for k, v in figure.layout.items() if k[1:5] == "axis"]
        assert all(a["exponentformat"] == "power" for a in axes)


def test_arrows_switch_between_before_and_after() -> None:
    figure = arrows(POINTS, BOTH, Machine(POINTS[:, :4].T), IDS, "mm", 1e-3)
    assert figure is not None
    for button in figure.layout["updatemenus"][0]["buttons"]:
        shown = button["args"][1]
        assert len(shown) == len(figure.data)
        assert shown[0] is True
        assert 1 < sum(shown) < len(shown)
    texts = [t["text"] for t in figure.data if t.get("hoverinfo") == "text"]
    assert all("pose 7" in text[7] for text in texts if len(text) == 50)


def test_a_pose_from_which_on_something_changed_is_marked() -> None:
    figure = drift(SERIES, IDS, SHADES)
    assert figure is not None
    assert figure.marked({}) is figure
    marked = figure.marked({21: "slip", 40: "b"})
    assert [shape["x0"] for shape in marked.layout["shapes"]] == [20.5, 39.5]
    assert "from pose slip, b on" in marked.caption
    go.Figure(data=list(marked.data), layout=dict(marked.layout))
