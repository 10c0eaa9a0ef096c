"""A change of some columns, all else fitted beside it: its size, its covariance and its test.

With u = U^T S^-1 e and G = U^T S^-1 U of the columns U, less what all else takes up of them,

    size = G^-1 u,   covariance = G^-1,   gain = u^T G^-1 u,

and the gain, what chi-squared falls by, is chi-squared with the rank of G if nothing changed.
Directions that all else takes up are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.chi_squared import tail


@dataclass(frozen=True, eq=False)
class Estimated:
    """along: (r,) the independent parts of a change [sds]; root: (d, r) of its covariance [SI]."""

    along: Array
    root: Array

    @classmethod
    def of(cls, u: Array, G: Array, scale: Array, least: float) -> Estimated:
        """From u (d,) and G (d, d) of columns times a scale (d,), so that they are alike; least:
        information in a direction that counts."""
        values, vectors = np.linalg.eigh(G)
        kept = values > least
        root = vectors[:, kept] / np.sqrt(values[kept])
        return cls(root.T @ u, scale[:, None] * root)

    @property
    def gain(self) -> float:
        """What chi-squared falls by."""
        return float(self.along @ self.along)

    @property
    def rank(self) -> int:
        """How many directions the equations show."""
        return len(self.along)

    @property
    def size(self) -> Array:
        """(d,) [SI]."""
        return np.asarray(self.root @ self.along)

    @property
    def covariance(self) -> Array:
        """(d, d) [SI]."""
        return np.asarray(self.root @ self.root.T)

    @property
    def sds(self) -> Array:
        """(d,) [SI]."""
        return np.sqrt(np.diag(self.covariance))

    def before(self, spare: float) -> float:
        """The gain in units of the scatter without the change, where it was found in units of that
        with it, of so many degrees of freedom."""
        # The squares left are spare + gain without the change, and spare with it.
        return self.gain / (1.0 + self.gain / spare)

    def log_p(self, spare: float = math.inf) -> float:
        """Log of the probability of such a gain; spare: as in `before`."""
        if math.isinf(spare):
            return log_tail(self.gain, self.rank)
        return log_share(self.gain / (spare + self.gain), self.rank, spare)


def log_share(share: float, rank: int, spare: float) -> float:
    """Log of the probability that so many columns explain by chance such a share of the squares.

    The share follows Beta(rank / 2, spare / 2), with `spare` degrees of freedom beside the columns.
    As chi-squared it is -(spare + rank / 2 - 1) log(1 - share) (Bartlett 1938, A note on tests of
    significance in multivariate analysis), which is exact for two columns.
    """
    left = max(1.0 - share, 1e-12)
    return log_tail(-(spare + 0.5 * rank - 1.0) * math.log(left), rank)


def log_tail(gain: float, rank: int) -> float:
    """Log of the probability of a chi-squared above the gain, also where it underflows."""
    if not rank or gain <= 0.0:
        return 0.0
    p = float(tail(np.array([gain]), np.array([rank]))[0])
    # Below, doubles lose digits until they end at 0, whose logarithm says nothing.
    if p > 1e-280:
        return math.log(p)
    half = 0.5 * rank  # the leading term of the asymptotic series
    return -0.5 * gain + (half - 1.0) * math.log(0.5 * gain) - math.lgamma(half)
