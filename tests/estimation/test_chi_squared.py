"""Probabilities of chi-squared, beside SciPy's and where they are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

from loopcal.estimation.chi_squared import chi_squared_limit, chi_squared_tail


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 20, 99, 100, 101, 873, 5000, 100_000])
def test_the_tail_is_scipys(freedom: int) -> None:
    spread = 2.0 / 9.0 / freedom
    # six sds below the mean to eight above (Wilson and Hilferty 1931)
    for z in np.linspace(-6.0, 8.0, 43).tolist():
        x = freedom * max(1.0 - spread + z * math.sqrt(spread), 1e-3) ** 3
        assert chi_squared_tail(x, freedom) == pytest.approx(chdtrc(freedom, x), rel=1e-12)


def test_with_two_degrees_the_tail_is_exponential() -> None:
    for x in (1e-300, 1e-3, 1.0, 4.0, 50.0, 1400.0):
        assert chi_squared_tail(x, 2) == pytest.approx(math.exp(-0.5 * x), rel=1e-12)


@pytest.mark.parametrize("freedom", [1, 2, 3, 1_000_000_000])
def test_the_tail_at_the_ends(freedom: int) -> None:
    assert chi_squared_tail(0.0, freedom) == 1.0
    assert chi_squared_tail(-1.0, freedom) == 1.0
    assert chi_squared_tail(1e300, freedom) == 0.0
    assert chi_squared_tail(math.inf, freedom) == 0.0
    assert math.isnan(chi_squared_tail(math.nan, freedom))


def test_half_lies_above_the_median_of_very_many_degrees() -> None:
    # the median lies 2/3 below the mean, but for what vanishes with the degrees
    for freedom in (10_000_000, 100_000_000):
        assert chi_squared_tail(freedom - 2.0 / 3.0, freedom) == pytest.approx(0.5, abs=1e-8)


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 99, 873])
@pytest.mark.parametrize("p", [0.95, 0.5, 0.05, 1e-5, 1e-12])
def test_the_limit_is_scipys(freedom: int, p: float) -> None:
    found = chi_squared_limit(p, freedom)
    assert found == pytest.approx(chdtri(freedom, p), rel=1e-12)
    assert chi_squared_tail(found, freedom) <= p
