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

from loopcal.document.verdict import Answer
from loopcal.presentation.shown import with_unit

Array = NDArray[np.float64]
SHARE = 0.95
"""Of all poses that shall lie within the tolerance."""
CONFIDENCE = 0.95
_NORMAL = 1.6448536269514722
"""The quantile of the standard normal distribution at `SHARE`."""
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
        known = distances[np.isfinite(distances)]
        if len(known) < _FEWEST:
            return None
        u = np.cbrt(np.square(known))
        mean, sd = float(u.mean()), float(u.std(ddof=1))
        factors = (_NORMAL, *_factors(len(known)))
        return cls(*(max(mean + k * sd, 0.0) ** 1.5 for k in factors))

    @classmethod
    def of_summary(cls, p95: float, poses: int) -> Quantile | None:
        """From the 95 % quantile of so many distances, those of normal errors in space."""
        if poses < _FEWEST:
            return None
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


def judged(quantile: Quantile | None, tolerance: float | None, unit: str, where: str) -> Answer:
    """The answer for a tolerance [unit]; where: of which poses the quantile speaks."""
    if tolerance is None:
        return Answer(None, "no-tolerance", None, "No tolerance is stated.", "State a tolerance.")
    if quantile is None:
        words = f"There are too few distances {where} for a decision."
        return Answer(None, "unknown-accuracy", None, words, "Measure more poses.")
    limit = with_unit(tolerance, unit)
    if not math.isfinite(quantile.value):
        words = f"The error {where} is unbounded; the tolerance is {limit}."
        return Answer(False, "outside-tolerance", None, words, "Measure poses all over the region.")
    found = f"95 % of poses {where} are within {with_unit(quantile.value, unit)}"
    band = f"{with_unit(quantile.low, unit)} to {with_unit(quantile.high, unit)}"
    words = f"{found} (guard band {band}); the tolerance is {limit}."
    if quantile.high <= tolerance:
        return Answer(True, "within-tolerance", quantile.value, words, None)
    if quantile.low > tolerance:
        return Answer(
            False,
            "outside-tolerance",
            quantile.value,
            words,
            "Improve the model or the sensors, calibrate again, or widen the tolerance.",
        )
    return Answer(
        None,
        "near-tolerance",
        quantile.value,
        words,
        "Measure more poses: the tolerance lies within the guard band.",
    )
