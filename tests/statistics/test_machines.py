"""Stated uncertainties of parallel machines hold; `analyses/machines.py` does it at full size."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import kstest

from analyses.machines import CASES, Counts, run

DRAWS = range(1000, 1003)


@cache
def counted() -> dict[str, Counts]:
    return {name: run(name, DRAWS) for name in CASES}


def test_every_default_set_is_determined() -> None:
    found = {name: counts.rank for name, counts in counted().items()}
    assert found == {name: case.identifiable for name, case in CASES.items()}


def test_chi_squared_is_as_large_as_its_degrees_of_freedom() -> None:
    """Four standard errors, which are known: chi-squared has the variance 2 nu."""
    for name, found in counted().items():
        spread = np.sqrt(2.0 / found.freedom / len(found.factors))
        assert abs(found.factors.mean() - 1.0) < 4 * spread, name


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Intervals of one draw share its errors: a draw counts once, and four errors of all."""
    held = np.concatenate([found.held.mean(axis=1) for found in counted().values()])
    assert abs(held.mean() - 0.95) < 4 * np.sqrt(0.95 * 0.05 / len(held))


def test_errors_of_all_parameters_follow_their_covariance() -> None:
    errors = np.concatenate([found.errors for found in counted().values()])
    assert kstest(errors, "uniform").pvalue > 0.005
