"""Probabilities of chi-squared, one number at a time, by `math` alone.

SciPy has them for arrays. But its special functions take longer to load than NumPy, and a
calibration that has nothing to doubt asks for no more than a p-value and a few limits.
"""

from __future__ import annotations

import math
import sys

_MOST = 10_000_000
_STIRLING = 50.0
"""From here on Stirling's series with three terms has all digits."""


def chi_squared_tail(x: float, freedom: int) -> float:
    """Probability of a chi-squared above x with so many degrees of freedom, one or more.

    The incomplete gamma function Q(freedom / 2, x / 2): its series below the mean, its continued
    fraction by Lentz's method above (Press and others, Numerical Recipes, 3rd ed. (2007), 6.2),
    to 1e-12 of its value up to a million degrees.
    """
    a, h = 0.5 * freedom, 0.5 * x
    if h <= 0.0:
        return 1.0
    if not math.isfinite(h):
        return 0.0 if h > 0.0 else math.nan
    return 1.0 - _below(a, h) if h < a + 1.0 else _above(a, h)


def chi_squared_limit(p: float, freedom: int) -> float:
    """The x above which chi-squared lies with this probability, 0 < p < 1."""
    low, high = 0.0, float(freedom)
    while chi_squared_tail(high, freedom) > p:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if chi_squared_tail(middle, freedom) > p else (low, middle)
    return high


def _below(a: float, h: float) -> float:
    """P(a, h) = h^a exp(-h) / gamma(a + 1) (1 + h / (a + 1) + h^2 / (a + 1)(a + 2) + ...)."""
    term = total = 1.0
    for i in range(1, _MOST):
        term *= h / (a + i)
        total += term
        if term <= sys.float_info.epsilon * total:
            break
    return _leading(a, h) * total


def _above(a: float, h: float) -> float:
    """Q(a, h) = h^a exp(-h) / gamma(a) / (h + 1 - a - 1 (1 - a) / (h + 3 - a - ...))."""
    b = h + 1.0 - a
    c, d = math.inf, 1.0 / b
    fraction = d
    for i in range(1, _MOST):
        b += 2.0
        numerator = i * (a - i)
        d = 1.0 / (b + numerator * d)
        c = b + numerator / c
        fraction *= c * d
        if abs(c * d - 1.0) <= sys.float_info.epsilon:
            break
    return a * _leading(a, h) * fraction


def _leading(a: float, h: float) -> float:
    """h^a exp(-h) / gamma(a + 1), the large terms cancelled before they are computed."""
    off = (h - a) / a
    ratio = math.log1p(off) if abs(off) < 0.5 else math.log(h / a)
    if a < _STIRLING:
        peak = a * math.log(a) - a - math.lgamma(a + 1.0)
    else:
        square = a * a
        series = (1.0 / 12.0 - (1.0 / 360.0 - 1.0 / (1260.0 * square)) / square) / a
        peak = -series - 0.5 * math.log(2.0 * math.pi * a)
    return math.exp(a * (ratio - off) + peak)
