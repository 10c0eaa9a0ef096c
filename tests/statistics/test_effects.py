"""Effects beyond geometry calibrate as stated; `analyses/effects.py` does the same at full size."""

from __future__ import annotations

from functools import cache
from math import sqrt

import numpy as np
import pytest
from scipy.stats import kstest

from analyses.effects import Counts, chosen, run

DRAWS = 30
# A draw counts once at least: the binomial error of one interval in each draw, four times.
POOLED = 4 * sqrt(0.95 * 0.05 / DRAWS)


@cache
def counted(setup: str) -> Counts:
    return run(setup, range(DRAWS))


@pytest.mark.parametrize("setup", ["yield", "all"])
def test_intervals_of_effects_hold_the_truth_as_often_as_they_say(setup: str) -> None:
    found = counted(setup)
    assert abs(found.own.mean() - 0.95) < POOLED / 2
    assert abs(found.every.mean() - 0.95) < POOLED / 2


@pytest.mark.parametrize("setup", ["yield", "all"])
def test_chi_squared_is_that_of_a_right_model(setup: str) -> None:
    found = counted(setup)
    error = found.chi_squared.std(ddof=1) / sqrt(DRAWS)
    assert abs(found.chi_squared.mean() - 1.0) < 4 * error
    assert kstest(found.p_values, "uniform").pvalue > 0.01


@pytest.mark.parametrize("true", ["geometric", "sag"])
def test_the_true_model_of_an_arm_is_recommended(true: str) -> None:
    assert {chosen(true, seed, poses=60, folds=4) for seed in range(2)} == {true}


def test_the_draws_differ() -> None:
    assert np.ptp(counted("yield").chi_squared) > 0.01
