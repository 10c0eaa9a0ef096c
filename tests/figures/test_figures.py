"""Figures as data: what plotly accepts, what is thinned and says so, what is drawn of numbers."""

from __future__ import annotations

import json

import numpy as np
import plotly.graph_objects as go
import pytest

from loopcal.figures.accuracy import distance_histogram, over_poses
from loopcal.figures.correlations import correlations
from loopcal.figures.figure import Figure, numbers
from loopcal.figures.sensors import drift, normalised
from loopcal.figures.space import arrows
from loopcal.figures.thinning import thinned

RANDOM = np.random.default_rng(3)
IDS = [str(i) for i in range(50)]
SERIES = {"x": RANDOM.standard_normal(50), "y<b>": RANDOM.standard_normal(50)}
POINTS, STEPS = RANDOM.standard_normal((3, 50)), 1e-3 * RANDOM.standard_normal((3, 50))


def every_figure() -> list[Figure]:
    found = [
        distance_histogram(np.abs(SERIES["x"]), 0.01 * np.abs(SERIES["x"]), "mm"),
        over_poses(SERIES, SERIES, IDS, "mm", "What"),
        over_poses(SERIES, {}, IDS, "mm", "What"),
        arrows(POINTS, STEPS, POINTS[:, :4].T, "mm", 1e-3),
        arrows(POINTS[:2], STEPS[:2], None, "mm", 1e-3),
        normalised(SERIES),
        drift(SERIES, IDS),
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
    assert json.loads(text)["layout"] == figure.layout


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
    figure = arrows(points, steps, None, "mm", 1e-3)
    assert figure is not None
    scale = float(figure.caption.split(" times")[0].rsplit(" ", 1)[1])
    shafts = [trace["x"][1] - trace["x"][0] for trace in figure.data]
    assert shafts == pytest.approx([1e-3 * scale, 2e-3 * scale], rel=1e-5)


def test_correlations_are_those_of_the_covariance() -> None:
    figure = correlations(np.array([[4.0, -1.0], [-1.0, 1.0]]), ["a", "b"])
    assert figure is not None
    assert figure.data[0]["z"] == [[1.0, -0.5], [-0.5, 1.0]]
    assert "-0.500 between a and b" in figure.label
    assert correlations(np.array([[4.0]]), ["a"]) is None


def test_unknown_numbers_are_gaps() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf])) == [1.23457, None, None]
    assert normalised({"x": np.full(3, np.nan)}) is None
    assert drift({}, []) is None
    assert over_poses({}, {}, [], "mm", "What") is None
    assert arrows(POINTS, np.full((3, 50), np.nan), None, "mm", 1e-3) is None
