"""The chi-squared distribution: tail, lower part and quantile.

Only what a default calibration needs: importing `scipy.special` takes longer than the fit itself.
The tests compare every function with SciPy.
"""

from __future__ import annotations

import math
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from loopcal.arrays import Array

_EPS = 2.0**-53
# The number of its terms grows with the freedom.
_CLOSED_FORM = 40
"""Degrees of freedom up to which arrays are evaluated by the finite sum."""
# B_2n / (2n (2n - 1)), the series of log Gamma (Abramowitz and Stegun 1964, 6.1.41).
_STIRLING = (1 / 12, -1 / 360, 1 / 1260, -1 / 1680, 1 / 1188, -691 / 360360)


@overload
def tail(x: float, freedom: float) -> float: ...
@overload
def tail(x: Array, freedom: ArrayLike) -> Array: ...
def tail(x: float | Array, freedom: ArrayLike) -> float | Array:
    """P(X >= x) for chi-squared X: Q(freedom / 2, x / 2).

    x and freedom are numbers, or arrays that broadcast; freedom is above zero, x is not negative.
    Q is the regularised upper incomplete gamma function (Abramowitz and Stegun 1964, 26.4.19).

    >>> round(tail(3.841458820694124, 1), 12)
    0.05
    """
    if isinstance(x, np.ndarray):
        return _tails(x, np.asarray(freedom, dtype=np.float64))
    return _parts(x, float(np.asarray(freedom)))[1]


def lower(x: float, freedom: float) -> float:
    """P(X <= x) for chi-squared X, accurate where it is small."""
    return _parts(float(x), float(freedom))[0]


@overload
def quantile(p: float, freedom: float) -> float: ...
@overload
def quantile(p: float, freedom: Array) -> Array: ...
def quantile(p: float, freedom: float | Array) -> float | Array:
    """The x with P(X >= x) = p, 0 < p <= 1.

    Newton's method on log P, which is concave: after one step the iterates fall towards x.

    >>> round(quantile(0.05, 1), 12)
    3.841458820694
    """
    if isinstance(freedom, np.ndarray):
        different, place = np.unique(freedom, return_inverse=True)
        return np.array([quantile(p, float(k)) for k in different])[place.reshape(freedom.shape)]
    if p >= 1.0:
        return 0.0
    # The mean, or far out where exp(-x / 2) = p.
    x = max(float(freedom), -2.0 * math.log(p))
    for _ in range(200):
        q = tail(x, freedom)
        a = 0.5 * freedom
        density = 0.5 * _power(a, 0.5 * x) / (0.5 * x)
        step = q / density * (math.log(q) - math.log(p))
        following = x + step if x + step > 0.0 else 0.5 * x
        if abs(following - x) <= 4 * _EPS * x:
            return following
        x = following
    return x


def _tails(x: Array, freedom: Array) -> Array:
    x, freedom = np.broadcast_arrays(x, freedom)
    out = np.empty(x.shape)
    for k in np.unique(freedom):
        at = freedom == k
        if float(k).is_integer() and k <= _CLOSED_FORM:
            out[at] = _finite_sum(x[at], int(k))
        else:
            out[at] = [tail(float(value), float(k)) for value in x[at]]
    return out


def _finite_sum(x: Array, k: int) -> Array:
    """Q for whole degrees of freedom (Abramowitz and Stegun 1964, 26.4.4 and 26.4.5)."""
    half = 0.5 * x
    with np.errstate(under="ignore", invalid="ignore", over="ignore"):
        if k % 2:
            total = np.array([math.erfc(root) for root in np.sqrt(half)])
            term = np.sqrt(half / math.pi) * 2.0 * np.exp(-half)
            steps = [0.5 * j for j in range(3, k, 2)]
            total = total + term if k > 1 else total
        else:
            total = term = np.exp(-half)
            steps = [0.5 * j for j in range(2, k, 2)]
        for step in steps:
            term = term * (half / step)
            total = total + term
    total[np.isposinf(x)] = 0.0
    return np.asarray(np.minimum(total, 1.0), dtype=np.float64)


def _parts(x: float, freedom: float) -> tuple[float, float]:
    """P(X <= x) and P(X >= x), each accurate where it is the smaller one."""
    a, z = 0.5 * freedom, 0.5 * x
    if math.isnan(z):
        return math.nan, math.nan
    if z <= 0.0:
        return 0.0, 1.0
    if math.isinf(z):
        return 1.0, 0.0
    power = _power(a, z)
    if z < a + 1.0:
        term = total = 1.0 / a  # series (Abramowitz and Stegun 1964, 6.5.29)
        n = a
        while term > total * _EPS:
            n += 1.0
            term *= z / n
            total += term
        low = min(power * total, 1.0)
        return low, 1.0 - low
    high = min(power * _continued_fraction(a, z), 1.0)
    return 1.0 - high, high


def _continued_fraction(a: float, z: float) -> float:
    """Q / (z^a e^-z / Gamma(a)) by the method of Lentz (1976) with 26.4.10's even part."""
    b = z + 1.0 - a
    c, d = 1e300, 1.0 / b
    h = d
    i = 0
    while True:
        i += 1
        an = i * (a - i)
        b += 2.0
        d = 1.0 / (an * d + b)
        c = b + an / c
        change = c * d
        h *= change
        if abs(change - 1.0) <= 2 * _EPS:
            return h


def _power(a: float, z: float) -> float:
    """z^a e^-z / Gamma(a) without overflow or cancellation."""
    if a < 10.0:
        return math.exp(a * math.log(z) - z - math.lgamma(a))
    stirling = sum(c * a ** -(2 * i + 1) for i, c in enumerate(_STIRLING))
    return math.sqrt(a / (2 * math.pi)) * math.exp(-a * _excess(z / a, (z - a) / a) - stirling)


def _excess(ratio: float, mu: float) -> float:
    """mu - log(ratio), where mu = ratio - 1 is accurate near 0."""
    if abs(mu) > 0.1:
        return mu - math.log(ratio)
    total, power = 0.0, mu
    for n in range(2, 40):
        power *= -mu
        total -= power / n
    return total
