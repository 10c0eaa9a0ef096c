"""By how much one way predicts poses better than another, with its paired standard error.

With distances a_i, b_i of the same N poses and D_i = b_i^2 - a_i^2,

    rms_b - rms_a = mean(D) / (rms_a + rms_b),   sd = sd(D) / sqrt(N) / (rms_a + rms_b).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CERTAIN = 2.0
"""So many sds of the difference make it significant."""


@dataclass(frozen=True)
class Gain:
    """difference: rms of the other minus rms of this one [unit]; sd: its paired standard error."""

    difference: float
    sd: float

    @classmethod
    def of(cls, distances: Array, others: Array) -> Gain | None:
        """From distances (N,) of both; None where fewer than two poses have both."""
        both = np.isfinite(distances) & np.isfinite(others)
        n = int(both.sum())
        if n < 2:
            return None
        a, b = np.square(distances[both]), np.square(others[both])
        total = math.sqrt(a.mean()) + math.sqrt(b.mean())
        if total == 0.0:
            return cls(0.0, 0.0)
        D = b - a
        return cls(float(D.mean()) / total, float(D.std(ddof=1)) / math.sqrt(n) / total)

    @property
    def better(self) -> bool | None:
        """Whether this one is better; None where the difference may be chance."""
        if abs(self.difference) <= CERTAIN * self.sd:
            return None
        return self.difference > 0.0
