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
        from scipy.special import nctdtrit

        known = distances[np.isfinite(distances)]
        n = len(known)
        if n < _FEWEST:
            return None
        u = np.cbrt(np.square(known))
        mean, sd, root = float(u.mean()), float(u.std(ddof=1)), math.sqrt(n)
        ends = [
            float(nctdtrit(n - 1.0, root * _NORMAL, p)) / root
            for p in (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE))
        ]
        value, low, high = (max(mean + k * sd, 0.0) ** 1.5 for k in (_NORMAL, *ends))
        return cls(value, low, high)


def judged(quantile: Quantile | None, tolerance: float | None, unit: str, where: str) -> Answer:
    """The answer for a tolerance [unit]; where: of which poses the quantile speaks."""
    if tolerance is None:
        return Answer(None, "no-tolerance", None, "No tolerance is stated.", "State a tolerance.")
    if quantile is None:
        words = f"The distances {where} are too few for a decision."
        return Answer(None, "unknown-accuracy", None, words, "Measure more poses.")
    limit = with_unit(tolerance, unit)
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
