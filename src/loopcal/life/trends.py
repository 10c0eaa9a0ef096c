"""How a machine changes over its life: drift rates, and a chart of its accuracy.

A parameter that was found as y_i with sd s_i at times t_i and that drifts as a random walk has

    y ~ N(m 1, diag(s_i^2) + q K),   K_ij = min(t_i, t_j) - t_1,

q its variance per year, learnt by restricted likelihood (Patterson and Thompson 1971). The
results count as independent. The chart is exponentially weighted (Roberts 1959): z_i = w x_i +
(1 - w) z_(i-1), with limits m +- 3 s sqrt(w / (2 - w) (1 - (1 - w)^(2 i))), s by moving ranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Sequence[float] | Array
FEWEST = 5
"""Results from which a drift rate is learnt."""
# Usually 0.2 to 0.3 (Hunter 1986); the largest follows few calibrations soonest.
WEIGHT = 0.3
# Shewhart's three sds, as in the formula above.
_LIMIT = 3.0
_RANGE = 1.128
"""Mean range of two normal values, in sds."""
# Powers of two, four to an octave: from a drift that no readings show to one that hides them all.
_GRID = np.linspace(-16.0, 8.0, 97)


@dataclass(frozen=True)
class Chart:
    """x: (n,) values; smooth, low, high: (n,) the weighted mean and its limits."""

    smooth: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def outside(self) -> bool:
        """Whether the last value is beyond its limits."""
        return not self.low[-1] <= self.smooth[-1] <= self.high[-1]


def drift_rate(years: Values, values: Values, sds: Values) -> float:
    """The sd by which a parameter drifts in a year [its unit]; 0 where nothing shows it."""
    t, y, s = np.asarray(years), np.asarray(values), np.asarray(sds)
    K = np.minimum.outer(t, t) - t.min()
    scale = float(np.square(s).mean()) / max(float(np.ptp(t)), 1e-9)
    rates = np.concatenate([[0.0], scale * 2.0**_GRID])
    criteria = [_criterion(np.diag(np.square(s)) + q * K, y) for q in rates]
    return float(np.sqrt(rates[int(np.argmin(criteria))]))


def _criterion(V: Array, y: Array) -> float:
    """-2 log of the restricted likelihood of a constant mean, up to a constant."""
    L = np.linalg.cholesky(V)
    one, z = np.linalg.solve(L, np.column_stack([np.ones(len(y)), y])).T
    information = float(one @ one)
    rest = z - one * float(one @ z) / information
    volume = 2.0 * float(np.log(np.diag(L)).sum()) + float(np.log(information))
    return volume + float(rest @ rest)


def chart(values: Values) -> Chart | None:
    """The chart of some values; None for fewer than three."""
    if len(values) < 3:
        return None
    x = np.asarray(values)
    mean, sd = float(x.mean()), float(np.abs(np.diff(x)).mean()) / _RANGE
    smooth, low, high, z = [], [], [], mean
    for i, value in enumerate(x.tolist(), 1):
        z = WEIGHT * value + (1.0 - WEIGHT) * z
        share = WEIGHT / (2.0 - WEIGHT) * (1.0 - (1.0 - WEIGHT) ** (2 * i))
        half = _LIMIT * sd * float(np.sqrt(share))
        smooth.append(z)
        low.append(mean - half)
        high.append(mean + half)
    return Chart(tuple(smooth), tuple(low), tuple(high))
