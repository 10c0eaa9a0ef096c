"""Losses over the whitened loop of a pose: how much a pose counts that does not fit.

With s = |E|^2 the least weighted square of a pose's corrections, r loop equations, u = sqrt(s):

    gaussian    rho = s
    huber       rho = s for u <= k, 2 k u - k^2 beyond       (Huber 1964, on the length of E)
    student-t   rho = (nu + r) log(1 + s / nu)               (multivariate t of dimension r)

A fit minimises the sum of rho. Its equations are those of least squares with each pose weighted
by w = d rho / d s, which is 1 or nearly so where a pose fits. Huber, Robust Statistics (1981),
chapter 7; Lange, Little and Taylor (1989).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np

from loopcal.arrays import Array
from loopcal.chi_squared import lower, tail
from loopcal.errors import unknown_name

LOSSES = ("gaussian", "huber", "student-t")
# The usual value (Holland and Welsch 1977).
EFFICIENCY = 0.95
"""What Huber's loss keeps of the gaussian fit's efficiency where every reading is good."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t (Lange, Little and Taylor 1989)."""


class Loss(Protocol):
    """A loss: functions of s = |E|^2 (b,) of poses with r loop equations each."""

    def rho(self, s: Array, r: int) -> Array:
        """What a pose costs, (b,)."""

    def weight(self, s: Array, r: int) -> Array:
        """w = d rho / d s, (b,), positive and falling."""

    def bend(self, s: Array, r: int) -> Array:
        """s dw/ds, (b,): how fast the weight falls."""


@dataclass(frozen=True)
class Huber:
    """Quadratic near zero, linear beyond: a gross error pulls no harder than a small one."""

    def rho(self, s: Array, r: int) -> Array:
        k = huber_constant(r)
        return np.where(s <= k * k, s, 2.0 * k * np.sqrt(s) - k * k)

    def weight(self, s: Array, r: int) -> Array:
        k = huber_constant(r)
        return k / np.sqrt(np.maximum(s, k * k))

    def bend(self, s: Array, r: int) -> Array:
        k = huber_constant(r)
        # w = k s^(-1/2) beyond k, so s dw/ds = -w / 2.
        return np.where(s <= k * k, 0.0, -0.5 * self.weight(s, r))


@dataclass(frozen=True)
class StudentT:
    """Student's t: beyond some sds a pose pulls the less the farther it is off."""

    freedom: float = FREEDOM

    def rho(self, s: Array, r: int) -> Array:
        return (self.freedom + r) * np.log1p(s / self.freedom)

    def weight(self, s: Array, r: int) -> Array:
        return (self.freedom + r) / (self.freedom + s)

    def bend(self, s: Array, r: int) -> Array:
        return -self.weight(s, r) * s / (self.freedom + s)


def loss_named(name: str) -> Loss | None:
    """The loss of that name; None for the gaussian one, which needs no weights.

    Raises InputError naming the nearest loss if there is none of that name.
    """
    if name not in LOSSES:
        raise unknown_name(f"there is no loss {name!r}", name, LOSSES)
    losses: dict[str, Loss] = {"huber": Huber(), "student-t": StudentT()}
    return losses.get(name)


@cache
def huber_constant(r: int) -> float:
    """The k at which Huber's loss on r equations keeps 95 % of the efficiency; 1.345 for r = 1.

    Efficiency E[div psi / r]^2 / E[|psi|^2 / r] over u, chi-distributed with r degrees of freedom,
    psi = min(1, k / u) E; it rises with k. Hampel and others, Robust Statistics (1986), 4.3.
    """
    low, high = 0.1, 10.0
    # 60 halvings of an interval of 10 end below the spacing of doubles.
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if huber_efficiency(middle, r) < EFFICIENCY else (low, middle)
    return 0.5 * (low + high)


def huber_efficiency(k: float, r: int) -> float:
    """Efficiency of Huber's loss with constant k on r whitened gaussian equations."""
    k2 = k * k
    slope = lower(k2, r)
    if r > 1:  # E[1/u; u > k], by the chi distribution of one degree less
        ratio = math.exp(math.lgamma(0.5 * (r - 1)) - math.lgamma(0.5 * r)) / math.sqrt(2.0)
        slope += (r - 1) / r * k * ratio * tail(k2, r - 1)
    square = lower(k2, r + 2) + k2 / r * tail(k2, r)
    return slope * slope / square
