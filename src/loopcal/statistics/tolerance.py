"""Good enough? Distances at some poses against a tolerance, with a guard band.

The tolerance shall hold in 95 % of all poses. Where distances are those of normal errors, their
power 2/3 is nearly normal (Wilson and Hilferty 1931), so both ends of the 95 % confidence interval
of its 95 % quantile are one-sided normal tolerance factors (noncentral t; Owen 1968). Within this
guard band the decision is open (JCGM 106:2012, section 8.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.document.judgement import Fact, Figure, fact

Array = NDArray[np.float64]
# The share that all pages state.
SHARE = 0.95
"""Of all poses that shall lie within the tolerance."""
# The level that all pages state.
CONFIDENCE = 0.95
_NORMAL = 1.6448536269514722
"""The quantile of the standard normal distribution at `SHARE`."""
# Two distances have an sd with one degree of freedom, whose bounds say nothing.
_FEWEST = 3


@dataclass(frozen=True)
class Quantile:
    """The distance that 95 % of poses do not exceed [unit], and the interval that holds it."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, distances: Array) -> Quantile | None:
        """From distances (N,), those that are missing left out; None for fewer than three."""
        finite = distances[np.isfinite(distances)]
        if len(finite) < _FEWEST:
            return None
        u = np.cbrt(np.square(finite))
        mean, sd = float(u.mean()), float(u.std(ddof=1))
        factors = (_NORMAL, *_factors(len(finite)))
        return cls(*(max(mean + k * sd, 0.0) ** 1.5 for k in factors))

    @classmethod
    def of_summary(cls, p95: float, poses: int) -> Quantile | None:
        """From the 95 % quantile of so many distances, those of normal errors in space."""
        if poses < _FEWEST:
            return None
        # Mean 1 - 2 / (9 k), variance 2 / (9 k) with k = 3 (Wilson and Hilferty 1931).
        mean, sd = 1.0 - 2.0 / 27.0, math.sqrt(2.0 / 27.0)  # of (chi-squared(3) / 3)^(1/3)
        middle = mean + _NORMAL * sd
        low, high = (max((mean + k * sd) / middle, 0.0) ** 1.5 for k in _factors(poses))
        return cls(p95, low * p95, high * p95)

    def widened(self, more: float) -> Quantile:
        """With an independent error of this 95 % quantile besides."""
        return Quantile(*(math.hypot(v, more) for v in (self.value, self.low, self.high)))


def _factors(poses: int) -> tuple[float, float]:
    """Tolerance factors of both ends of the interval, for so many poses."""
    from scipy.special import nctdtrit

    root = math.sqrt(poses)
    chances = 0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)
    low, high = (float(nctdtrit(poses - 1.0, root * _NORMAL, p)) / root for p in chances)
    return low, high


def kept(quantile: Quantile | None, tolerance: float, unit: str, where: str) -> Fact:
    """Whether a tolerance [unit] is kept; where: of which poses the quantile speaks."""
    if quantile is None:
        return fact("few-distances", where=where)
    limit = Figure(tolerance, unit)
    if not math.isfinite(quantile.value):
        return fact("error-unbounded", where=where, limit=f"{limit}")
    sizes = {"error": quantile.value, "low": quantile.low, "high": quantile.high}
    numbers = {name: Figure(value, unit) for name, value in sizes.items()} | {"tolerance": limit}
    code = "near-tolerance"
    if quantile.high <= tolerance:
        code = "within-tolerance"
    elif quantile.low > tolerance:
        code = "outside-tolerance"
    return fact(code, numbers=numbers, where=where)
