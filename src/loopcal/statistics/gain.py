"""By how much one way predicts poses better than another, with its paired standard error.

With risks r_i, s_i of the same N poses, D_i = s_i - r_i, and G clusters g of poses whose errors
belong together (by default each pose its own),

    difference = mean(D),   sd^2 = G / (G - 1) sum_g (sum_{i in g} (D_i - mean(D)))^2 / N^2.

Where risks are squared distances, rms_s - rms_r = mean(D) / (rms_r + rms_s), and so its sd.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array

# Record 0047: the 97.5 % point on each side.
LEVEL = 0.05
"""Family of two sides: a difference this unlikely by chance is significant."""


@dataclass(frozen=True)
class Gain:
    """difference: mean risk of the other minus that of this one; sd: its standard error, infinite
    where it is not known; clusters: of poses whose errors belong together."""

    difference: float
    sd: float
    clusters: int

    @classmethod
    def of(cls, risks: Array, others: Array, cluster: NDArray[np.intp] | None = None) -> Gain:
        """From risks (N,) of both, NaN where there is none; cluster: (N,) labels."""
        both = others - risks
        finite = np.isfinite(both)
        number = int(finite.sum())
        if not number:
            return cls(math.nan, math.inf, 0)
        labels = np.arange(len(both)) if cluster is None else cluster
        label = np.unique(labels[finite], return_inverse=True)[1]
        count = int(label.max()) + 1
        mean = float(both[finite].mean())
        if count == 1:
            return cls(mean, math.inf, 1)
        sums = np.bincount(label, both[finite] - mean)
        sd = math.sqrt(count / (count - 1) * float(np.square(sums).sum())) / number
        return cls(mean, sd, count)

    @classmethod
    def in_rms(
        cls, squares: Array, others: Array, cluster: NDArray[np.intp] | None = None
    ) -> Gain | None:
        """Of root mean squares, from squared distances (N,); None below two clusters."""
        gain = cls.of(squares, others, cluster)
        if gain.clusters < 2:
            return None
        finite = np.isfinite(squares) & np.isfinite(others)
        total = math.sqrt(squares[finite].mean()) + math.sqrt(others[finite].mean())
        if total == 0.0:
            return cls(0.0, 0.0, gain.clusters)
        return cls(gain.difference / total, gain.sd / total, gain.clusters)

    @property
    def better(self) -> bool | None:
        """Whether this one is better; None where the difference may be chance."""
        from scipy.special import stdtrit

        if self.clusters < 2:
            return None
        chance = float(stdtrit(self.clusters - 1, 1.0 - 0.5 * LEVEL)) * self.sd
        return None if abs(self.difference) <= chance else self.difference > 0.0
