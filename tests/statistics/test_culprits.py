"""What is at fault where images do not fit: the one that was simulated to be."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.document.choice import Candidate
from loopcal.document.tables import culprit_table, culprit_words
from loopcal.estimation.fit import Fit
from loopcal.statistics.case import Case
from loopcal.statistics.choice import choose
from loopcal.statistics.folds import Scheme
from tests.mechanisms.test_camera import hands, mechanism, pixels, readings

PRIORS = {"eye_f": 30.0, "eye_c?": 30.0, "eye_k?": 0.1, "eye_p?": 0.01}


def judged(f: float, size: float) -> tuple[Candidate, ...]:
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
    return choose(case, Scheme(folds=4)).result.parts.culprits


@pytest.mark.parametrize(
    ("f", "size", "fault"), [(1.02, 1.0, "lens"), (1.0, 1.01, "board"), (1.0, 1.0, "")]
)
def test_what_was_stated_wrongly_is_at_fault(f: float, size: float, fault: str) -> None:
    culprits = judged(f, size)
    assert [one.name for one in culprits][1:3] == ["lens", "board"]
    words = culprit_words(culprits, "px")
    assert (f"Freeing the {fault} gains most" in words) == bool(fault)
    table = culprit_table(culprits, "px")
    assert table is not None
    assert len(table.rows) == 4
