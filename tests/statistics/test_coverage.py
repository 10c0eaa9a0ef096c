"""Stated uncertainties hold, over many draws; `analyses/coverage.py` does the same at full size."""

from __future__ import annotations

from functools import cache
from math import sqrt

import numpy as np
import pytest
from scipy.stats import kstest

from analyses.coverage import Case, Counts, gear_error_p, run, standard_error

DRAWS = 150
CASES = [Case(m, "base", proper) for m in ("planar", "six-axis") for proper in (False, True)]
# Intervals of one draw share its errors, so a draw counts once: the binomial error of the draws
# bounds that of the pooled coverage; four of them are exceeded once in 16,000 times.
POOLED = 4 * sqrt(0.95 * 0.05 / DRAWS)


@cache
def counted(case: Case) -> Counts:
    return run(case, range(DRAWS))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_intervals_hold_the_truth_as_often_as_they_say(case: Case) -> None:
    found = counted(case)
    assert abs(found.held.mean() - 0.95) < POOLED
    assert abs(found.points.mean() - 0.95) < POOLED
    # each parameter by itself, one of 27: five binomial errors
    assert found.held.mean(axis=0).min() > 0.95 - 1.25 * POOLED


@pytest.mark.parametrize("case", CASES, ids=str)
def test_p_values_of_a_right_model_are_uniform(case: Case) -> None:
    assert kstest(counted(case).p_values, "uniform").pvalue > 0.01


def test_a_gear_error_is_rejected() -> None:
    p = np.array([gear_error_p(seed) for seed in range(40)])
    assert (p < 0.05).mean() > 0.95


def test_the_standard_error_counts_a_draw_once() -> None:
    """Intervals that all hold or all miss say no more than one of them would."""
    one = np.random.default_rng(1).random(400) < 0.95
    alike = np.repeat(one[:, None], 10, axis=1)
    assert standard_error(np.where(alike, 1.0, 0.0)) == pytest.approx(one.std(ddof=1) / 20)
    apart = np.random.default_rng(2).random((400, 10)) < 0.95
    assert standard_error(np.where(apart, 1.0, 0.0)) == pytest.approx(
        sqrt(0.95 * 0.05 / 4000), rel=0.15
    )
