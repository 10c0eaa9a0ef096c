"""What images say of robot, lens and board: what is at fault, halves, and regions of the image."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.document.accuracy import Distances
from loopcal.document.choice import Candidate
from loopcal.document.fit import NoiseEntry
from loopcal.document.result_document import Parts
from loopcal.document.tables import culprit_table, culprit_words
from loopcal.estimation.fit import Fit
from loopcal.statistics.case import Case
from loopcal.statistics.choice import choose
from loopcal.statistics.folds import Scheme, image_regions
from tests.mechanisms.test_camera import hands, mechanism, pixels, readings

PRIORS = {"eye_f": 30.0, "eye_c?": 30.0, "eye_k?": 0.1, "eye_p?": 0.01}


def judged(f: float, size: float) -> Parts:
    """Of 16 images whose lens is stated as f times what it is, their board as 1 / size."""
    T = hands(16, 2)
    uv = pixels(T, on="base") + np.random.default_rng(3).normal(0.0, 0.2, (12, 2, 16))
    table = readings(T, uv)
    if size != 1.0:
        # A print that is larger and a robot that is larger look alike: the lengths are the robot's.
        table |= {axis: table[axis] / size for axis in "xyz"}
    made = mechanism("base")
    places = {f"{thing}_{axis}" for thing in ("eye", "board") for axis in "xyz"}
    nominal = {n: made.parameters[n].nominal / size for n in places}
    made = made.with_nominal({**nominal, "eye_f": f * made.parameters["eye_f"].nominal})
    made = made.with_parameters(made.parameters.with_prior(PRIORS))
    noise = lc.Noise({"[xyz]": 1e-4, "w?": 1e-4, "eye": 0.2})
    case = Case(made, lc.Dataset.from_arrays(table), noise, Fit())
    return choose(case, Scheme(folds=4)).result.parts


@pytest.mark.parametrize(("f", "size", "fault"), [(1.02, 1.0, "lens"), (1.0, 1.01, "board")])
def test_what_was_stated_wrongly_is_at_fault(f: float, size: float, fault: str) -> None:
    parts = judged(f, size)
    culprits = parts.culprits
    assert [one.name for one in culprits][1:3] == ["lens", "board"]
    words = culprit_words(culprits, "px")
    assert f"Freeing the {fault} gains most" in words
    table = culprit_table(culprits, "px")
    assert table is not None
    assert len(table.rows) == 4
    assert parts.validation is not None
    assert parts.validation.images is not None
    assert parts.validation.images.words == "3 regions of the image of 16 poses"
    assert parts.validation.images.places
    # A step would state no region.
    assert parts.validation.images.coverage is not None
    assert {one.name for one in parts.halves} >= {"eye_f", "eye_cx", "eye_k1"}
    assert max(abs(one.sds) for one in parts.halves) < 4.0


def test_what_moved_before_a_camera_is_a_camera_or_a_board() -> None:
    T, moved = hands(30, 2), np.eye(4)
    moved[:3, 3] = 2e-3, -1e-3, 0.0
    T_seen = np.where(np.arange(30)[:, None, None] < 15, T, moved @ T)
    uv = pixels(T_seen, on="base") + np.random.default_rng(3).normal(0.0, 0.2, (12, 2, 30))
    noise = lc.Noise({"[xyz]": 1e-4, "w?": 1e-4, "eye": 0.2})
    made = mechanism("base")
    made = made.with_parameters(made.parameters.with_prior(PRIORS))
    data = lc.Dataset.from_arrays(readings(T, uv))
    (point,) = lc.find_shifts(lc.calibrate(made, data, noise=noise, method="implicit-loop")).found
    assert point.of == "the camera 'eye'"
    assert "the place of the camera 'eye' changed (eye_x" in point.what


def test_a_gain_below_two_standard_errors_accuses_nothing() -> None:
    def one(name: str, rms: float, gain: float) -> Candidate:
        distances = Distances(rms, rms, rms, rms, 20)
        return Candidate(name, distances, None, -gain, 0.1)

    stated, free = one("nominal", 1.0, 0.0), one("implicit-loop", 0.7, 0.3)
    little, much = one("lens", 0.81, 0.19), one("board", 0.79, 0.21)
    assert "no better than as stated" in culprit_words((stated, little, free), "px")
    assert "Freeing the board gains most" in culprit_words((stated, little, much, free), "px")
    assert culprit_words((), "px") == ""


def test_regions_of_the_image_are_where_the_camera_sees_the_board() -> None:
    T = hands(16, 2)
    table = readings(T, pixels(T, on="base"))
    far = np.arange(16) % 4 == 0
    for name in table:
        if name.endswith(":u"):
            table[name] = np.where(far, table[name] + 3000.0, table[name])
    table["eye:board:0:v"] = np.full(16, np.nan)  # a corner that no image shows
    data = lc.Dataset.from_arrays(table)
    made = image_regions(mechanism("base"), data, np.arange(16), most=2)
    assert made is not None
    assert sorted(map(tuple, made.indices)) == [(0, 4, 8, 12), tuple(np.flatnonzero(~far))]
    assert image_regions(mechanism("base"), data.take(slice(9)), np.arange(9)) is None


def test_sensors_have_names_for_the_reader() -> None:
    def label(*names: str) -> str:
        return NoiseEntry(names, "1", 1.0, None, "given").label

    assert label("eye:board:0:u", "eye:board:17:v") == "corners of 'eye'"
    assert label("wx", "wy", "wz") == "small turns wx, wy, wz"
    assert label("x", "y", "z") == "x, y, z"
    assert label(*(f"q{i}" for i in range(20))) == "q0 ... q19"
