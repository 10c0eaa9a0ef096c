"""The chi-squared distribution against SciPy and against sums in exact arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.special import chdtr, chdtrc, chdtri

from loopcal import chi_squared

FREEDOMS = (0.3, 1, 2, 3, 5, 6, 7.7, 10, 19, 21, 40, 100, 716, 1e4, 1e5)
OFFSETS = (-4, -3, -1, 0, 0.5, 1, 2, 3, 5, 8)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_tail_and_lower_part_are_those_of_scipy(freedom: float) -> None:
    for sds in OFFSETS:
        x = max(freedom + sds * math.sqrt(2 * freedom), 1e-3)
        assert chi_squared.tail(x, freedom) == pytest.approx(chdtrc(freedom, x), rel=2e-12)
        assert chi_squared.lower(x, freedom) == pytest.approx(chdtr(freedom, x), rel=2e-12)


@pytest.mark.parametrize("freedom", FREEDOMS)
@pytest.mark.parametrize("p", [0.999, 0.5, 0.05, 1e-3, 1e-8, 1e-12])
def test_quantile_is_that_of_scipy(freedom: float, p: float) -> None:
    assert chi_squared.quantile(p, freedom) == pytest.approx(chdtri(freedom, p), rel=1e-12)


def test_far_below_a_large_expectation_the_exact_series_holds() -> None:
    """SciPy stops its series early there: 8e-9 off at a million degrees of freedom."""
    a, z = Fraction(10**5), Fraction(10**5 - 2500)
    total, term = 0.0, 1.0
    n = int(a)
    while term > 1e-18:
        total += term
        n += 1
        term *= float(z) / n
    # z^a e^-z / Gamma(a + 1) by exact logarithms of its factors
    logarithm = math.fsum([math.log(z / k) for k in range(1, int(a) + 1)]) - float(z)
    expected = total * math.exp(logarithm)
    assert chi_squared.lower(2 * float(z), 2 * float(a)) == pytest.approx(expected, rel=1e-9)


def test_arrays_are_evaluated_as_their_numbers() -> None:
    rng = np.random.default_rng(0)
    freedom = rng.integers(1, 9, 500).astype(np.float64)
    freedom[:3] = 4.5, 60.0, 900.0
    x = 3 * freedom * rng.random(500)
    x[3:5] = 0.0, np.inf
    expected = [chi_squared.tail(a, k) for a, k in zip(x.tolist(), freedom.tolist(), strict=True)]
    np.testing.assert_allclose(chi_squared.tail(x, freedom), expected, rtol=1e-13)
    limits = chi_squared.quantile(0.01, freedom)
    np.testing.assert_allclose(chi_squared.tail(limits, freedom), 0.01, rtol=1e-12)


def test_the_ends_of_the_range() -> None:
    assert chi_squared.tail(0.0, 3) == 1.0
    assert chi_squared.tail(math.inf, 3) == 0.0
    assert chi_squared.tail(1e5, 3) == 0.0
    assert chi_squared.quantile(1.0, 3) == 0.0
    assert math.isnan(chi_squared.tail(math.nan, 3))
