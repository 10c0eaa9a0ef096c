"""The spread of one parameter between machines, from few machines with uncertain values.

A parameter was found as y_r with variance v_r at R machines, whose true values scatter with the
variance w about a mean:

    y_r ~ N(m, w + v_r).

w is learnt by restricted likelihood (Patterson and Thompson 1971). At the true w

    Q(w) = sum_r (y_r - m(w))^2 / (w + v_r)

is chi-squared with R - 1 degrees of freedom, m(w) the weighted mean. Q falls with w, so quantiles
of chi-squared give exact limits of w (Viechtbauer 2007), and draws of chi-squared the spreads that
the values allow. What a further machine may be is averaged over these (Tsui and Weerahandi 1989);
where v is small, that is Student's t with R - 1 degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.lazy import cached_property

LEVEL = 0.95
_EDGES = np.concatenate([[0.0], np.geomspace(1e-7, 0.1, 61), np.linspace(0.1, 1.0, 46)[1:]])
"""Levels of chi-squared between which draws are taken; dense where the spread is large."""
# Bisections: 2^-60 of the first interval is below the rounding of a double.
_STEPS = 60
# The fixed-point steps below converge linearly; they end by themselves long before.
_ROUNDS = 2_000


@dataclass(frozen=True, eq=False)
class Spread:
    """values, variances: (R,) of one parameter [its unit, and squared]."""

    values: Array
    variances: Array

    @classmethod
    def of(cls, values: Array, variances: Array) -> Spread:
        """From the values that results found; variances of zero count as rounding."""
        least = max(1e-24 * float(np.square(values).max()), 1e-300)
        return cls(values, np.maximum(variances, least))

    @cached_property
    def variance(self) -> float:
        """Between machines, by restricted likelihood; 0 where nothing shows it."""
        y, v = self.values, self.variances
        begun = w = float(np.var(y, ddof=1) + v.mean())
        for _ in range(_ROUNDS):
            g = 1.0 / (w + v)
            rest = y - float(g @ y) / float(g.sum())
            # d/dw of the restricted likelihood is 0 where the sum of squares equals its
            # expectation; the multiplicative step w sqrt(squares / expected) never leaves w > 0.
            squares, expected = np.square(g * rest).sum(), g.sum() - np.square(g).sum() / g.sum()
            before, w = w, w * float(np.sqrt(squares / expected))
            if abs(w - before) <= 1e-9 * before or w < 1e-9 * begun:
                break
        return w if w > 1e-6 * float(v.min()) else 0.0

    @property
    def sd(self) -> float:
        """Between machines [unit]."""
        return float(np.sqrt(self.variance))

    @cached_property
    def low(self) -> float:
        """The lower limit of the 95 % interval of the sd; 0: only the bound is known."""
        return self._limit(0.5 + 0.5 * LEVEL)

    @cached_property
    def high(self) -> float:
        """Its upper limit."""
        return self._limit(0.5 - 0.5 * LEVEL)

    @property
    def mean(self) -> float:
        """Of the machines."""
        return float(self._means(np.array([self.variance]))[0])

    @property
    def mean_sd(self) -> float:
        """Of the mean, at the spread that was learnt."""
        return float(np.sqrt(self._mean_variances(np.array([self.variance]))[0]))

    def tail(self, value: float, variance: float) -> float:
        """The chance that one more machine is found at least so far away as this one."""
        w = self._draws
        sds = np.sqrt(w + self._mean_variances(w) + variance)
        return float(_WEIGHTS @ _outside(np.abs(value - self._means(w)) / sds))

    @cached_property
    def predictive_sd(self) -> float:
        """The sd of one more machine: 1.96 of it hold the true value in 95 % of fleets."""
        w = self._draws
        sds, away = np.sqrt(w + self._mean_variances(w)), self._means(w) - self.mean
        low, high = 0.0, 1e9 * float(sds.min()) + float(np.abs(away).max())
        for _ in range(2 * _STEPS):
            half = 0.5 * (low + high)
            out = 0.5 * (_outside((half - away) / sds) + _outside((half + away) / sds))
            low, high = (half, high) if _WEIGHTS @ out > 1.0 - LEVEL else (low, half)
        return high / float(np.sqrt(_quantiles(np.array([LEVEL]), 1)[0]))

    def _limit(self, level: float) -> float:
        return float(np.sqrt(self._at(_quantiles(np.array([level]), self._freedom))[0]))

    @property
    def _freedom(self) -> int:
        return len(self.values) - 1

    @cached_property
    def _draws(self) -> Array:
        """(K,) variances between machines that the values allow, of the weights above."""
        return self._at(_quantiles(_LEVELS, self._freedom))

    def _at(self, Q: Array) -> Array:
        """(K,) the w at which Q(w) is so large; 0 where it never is."""
        low = np.zeros(len(Q))
        high = np.square(self.values - self.values.mean()).sum() / Q
        for _ in range(_STEPS):
            w = 0.5 * (low + high)
            above = self._Q(w) > Q
            low, high = np.where(above, w, low), np.where(above, high, w)
        # Where Q(0) is below the quantile, chance alone explains the scatter: w = 0.
        return np.where(self._Q(np.zeros(len(Q))) > Q, high, 0.0)

    def _Q(self, w: Array) -> Array:
        rest = self.values - self._means(w)[:, None]
        return np.asarray((np.square(rest) / (w[:, None] + self.variances)).sum(axis=1))

    def _means(self, w: Array) -> Array:
        g = 1.0 / (w[:, None] + self.variances)
        return np.asarray(g @ self.values / g.sum(axis=1))

    def _mean_variances(self, w: Array) -> Array:
        return np.asarray(1.0 / (1.0 / (w[:, None] + self.variances)).sum(axis=1))


_WEIGHTS = np.diff(_EDGES)
_LEVELS = 0.5 * (_EDGES[1:] + _EDGES[:-1])


def _quantiles(levels: Array, freedom: int) -> Array:
    """Of chi-squared."""
    from scipy.special import gammaincinv

    return np.asarray(2.0 * gammaincinv(0.5 * freedom, levels))


def _outside(z: Array) -> Array:
    """The chance of a normal value beyond +- z; more than 1 for z below 0, as one side needs."""
    from scipy.special import ndtr

    return np.asarray(2.0 * ndtr(-z))
