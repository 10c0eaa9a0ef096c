"""95 % intervals of lengths, of sds and of repeatability.

The length of a mean is never negative, and noise makes it longer: |d + e|, e ~ N(0, C), has the
mean square |d|^2 + tr C. With u = d/|d| and s = |d|, its square is close to c times a non-central
chi-squared. That has k degrees of freedom and the non-centrality s^2/c, where

    c = (tr C^2 + 2 s^2 u^T C u) / (tr C + 2 s^2),    k = tr C / c,

which has the right mean and variance at every s (Patnaik 1949 for s = 0). The interval holds all s
at which the length found is neither too large nor too small. Repeatability l + 3 S scales with the
scatter, so its square is close to a multiple of chi-squared; the degrees of freedom follow from the
variances of the mean l and of S, and their correlation, of normal scatter in space.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.small_samples import t_quantile

LEVEL = 0.95
# At 25 sds the length differs from its component along the vector by 1 / 50 of an sd per freedom.
FAR = 25.0
"""Sds from zero beyond which the length of a vector is normal."""


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval [SI]; None for a bound that the data do not determine."""

    value: float
    low: float | None
    high: float | None


def length_interval(
    vector: Array, covariance: Array, scatter: Array, degrees: float, level: float = LEVEL
) -> Estimate:
    """The length of an estimated vector (d,), d from 1 to 3.

    covariance (d, d): of the estimate; scatter (d, d): the part of it that was itself estimated,
    with so many degrees of freedom. Degrees below 1: there is no interval.
    """
    value = float(np.linalg.norm(vector))
    trace = float(np.trace(covariance))
    if degrees < 1.0:
        return Estimate(value, None, None)
    if not trace > 0.0:
        return Estimate(value, value, value)
    # noise turns a short vector: its variance is anything up to the largest one then
    sure = value * value / (value * value + trace)
    u = vector / value if value > 0.0 else vector
    along, estimated = (
        sure * float(u @ C @ u) + (1.0 - sure) * float(np.linalg.eigvalsh(C)[-1])
        for C in (covariance, scatter)
    )
    freedom = math.inf if estimated <= 1e-9 * along else degrees * (along / estimated) ** 2
    t, sd = t_quantile(level, freedom), math.sqrt(along)
    if value > FAR * t * sd:
        return Estimate(value, value - t * sd, value + t * sd)
    return _length_bounds(value, covariance, along, t)


def size_interval(value: float, scatter: float, variance: float, degrees: float) -> Estimate:
    """The size of one number; variance: of it, scatter: the part of that which was estimated."""
    return length_interval(
        np.array([value]), np.array([[variance]]), np.array([[scatter]]), degrees
    )


def _length_bounds(value: float, covariance: Array, along: float, t: float) -> Estimate:
    from scipy.special import chndtr, ndtr

    trace, square = float(np.trace(covariance)), float(np.sum(covariance * covariance.T))
    tail = float(ndtr(-t))

    def at_most(s: float) -> float:
        c = (square + 2.0 * s * s * along) / (trace + 2.0 * s * s)
        return float(chndtr(value * value / c, trace / c, s * s / c))

    # Six sds beyond the interval: the upper bound lies inside.
    reach = value + (t + 6.0) * math.sqrt(trace)
    low = 0.0 if 1.0 - at_most(0.0) >= tail else _crossing(at_most, 1.0 - tail, reach)
    high = 0.0 if at_most(0.0) <= tail else _crossing(at_most, tail, reach)
    return Estimate(value, low, max(high, value + math.sqrt(along)))  # never an empty interval


def _crossing(falling: Callable[[float], float], level: float, high: float) -> float:
    """Where a falling function passes a level, above 0."""
    low = 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if falling(middle) > level else (low, middle)
    return 0.5 * (low + high)


def spread_interval(sd: float, degrees: float, factor: float = 1.0) -> Estimate:
    """factor times an sd that was estimated with so many degrees of freedom, by chi-squared."""
    value = factor * sd
    if degrees < 1.0:
        return Estimate(value, None, None)
    tail = 0.5 * (1.0 - LEVEL)
    return Estimate(
        value,
        value * math.sqrt(degrees / quantile(tail, degrees)),
        value * math.sqrt(degrees / quantile(1.0 - tail, degrees)),
    )


@dataclass(frozen=True)
class NormalScatter:
    """Distances l from the mean of normal scatter: their mean, sd, skewness and kurtosis."""

    mean: float
    sd: float
    skewness: float
    kurtosis: float

    @classmethod
    def of(cls, covariance: Array) -> NormalScatter:
        """From the covariance (d, d) of the scatter.

        With Q = l^2 and phi(t) = E exp(-t Q) = prod (1 + 2 a_i t)^(-1/2), a_i the eigenvalues:
        E l = 1/(2 sqrt pi) int (1 - phi) t^(-3/2) dt, and E l^3 alike from E Q and its part.
        """
        a = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
        scale = float(a.sum())
        if not scale > 0.0:
            return cls(0.0, 0.0, 0.0, 3.0)
        a = a / scale
        # At t = exp(-70) and exp(70) the integrands, of order sqrt t and 1 / sqrt t, are below
        # rounding.
        w = np.arange(-70.0, 70.0, 0.05)  # t = exp w: the sum over even steps converges at once
        t = np.exp(w)
        stretched = 1.0 + 2.0 * np.outer(t, a)
        phi = np.prod(stretched, axis=1) ** -0.5
        weight = 0.05 * np.exp(-0.5 * w) / (2.0 * math.sqrt(math.pi))
        # 1 - phi without cancellation where t is small
        first = float(weight @ -np.expm1(-0.5 * np.log1p(2.0 * np.outer(t, a)).sum(axis=1)))
        lost = (a * (1.0 - phi[:, None] / stretched)).sum(axis=1)
        small = t < 1e-6
        # The first term of the series in t, where the difference above has no digits left.
        lost[small] = t[small] * (1.0 + 2.0 * float(a @ a))
        third = float(weight @ lost)
        fourth = 1.0 + 2.0 * float(a @ a)
        variance = 1.0 - first**2
        central3 = third - 3.0 * first + 2.0 * first**3
        central4 = fourth - 4.0 * first * third + 6.0 * first**2 - 3.0 * first**4
        root = math.sqrt(scale)
        return cls(
            root * first,
            root * math.sqrt(variance),
            central3 / variance**1.5,
            central4 / variance**2,
        )

    @property
    def repeatability(self) -> float:
        """RP = mean + 3 sd, of infinitely many cycles."""
        return self.mean + 3.0 * self.sd

    def degrees(self, cycles: int) -> float:
        """Degrees of freedom of chi-squared that matches the variance of RP from so many cycles."""
        variance = self.sd**2 * (
            1.0 + 9.0 * (self.kurtosis - 1.0) / 4.0 + 3.0 * self.skewness
        )  # of the mean l, of 3 S, and twice their covariance
        return self.repeatability**2 * (cycles - 1) / (2.0 * variance)


def repeatability(deviations: Array) -> Estimate:
    """RP = mean l + 3 S_l (ISO 9283), l the distances of readings (n, 3) from their mean.

    The interval is that of the RP of infinitely many cycles: n readings lie nearer to their own
    mean by sqrt((n - 1)/n) on average.
    """
    n = len(deviations)
    lengths = np.linalg.norm(deviations - deviations.mean(axis=0), axis=1)
    if n < 2:
        return Estimate(0.0, None, None)
    value = float(lengths.mean() + 3.0 * lengths.std(ddof=1))
    scatter = NormalScatter.of(np.atleast_2d(np.cov(deviations.T)))
    if not scatter.sd > 0.0:
        return Estimate(value, value, value)
    interval = spread_interval(value, scatter.degrees(n))
    if interval.low is None or interval.high is None:
        return interval
    bias = math.sqrt(n / (n - 1.0))
    return Estimate(value, bias * interval.low, bias * interval.high)
