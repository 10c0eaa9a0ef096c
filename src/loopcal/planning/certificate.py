"""How far any choice could still be better: the continuous optimum and its bound.

Let every candidate be measured w_i times, 0 <= w_i <= 1 and sum w_i = n, fractions allowed. The
criterion f is convex in w. With its slopes -g_i at any w,

    f(v) >= f(w) - (the n largest g_i added up - sum w_i g_i)   for every such v,

so also for the best choice of n poses. The weights follow multiplicative steps w_i (g_i / mean)^a
(Silvey, Titterington and Torsney 1978), capped at 1. a = 1/2 lowers f always, and grows as long as
it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.planning.information import Information
from loopcal.planning.search import (
    Criterion,
    criterion_value,
    inverse,
    linear_aim,
    test_variances,
)

Array = NDArray[np.float64]
_CLOSE = 1e-3
"""Share of the criterion that the bound may still miss."""
# Floating-point operations spent on the bound: some seconds on one core.
_EFFORT = 1.5e10
_FEWEST, _MOST = 12, 400
# Of G: the step of the multiplicative weights of test poses is just below 1.
_PEAK = 60.0
_POWER, _GROWS, _STEEPEST = 0.5, 1.4, 8.0


@dataclass(frozen=True)
class Certificate:
    """bound: no choice of so many candidates has a smaller criterion; value: of the choice;
    efficiency: bound over value, of D the root of the ratio of determinants, at most 1."""

    value: float
    bound: float
    efficiency: float


def certificate(
    draws: Sequence[Information], chosen: Sequence[int], criterion: Criterion
) -> Certificate:
    """The bound for as many candidates as were chosen."""
    n = len(chosen)
    N = len(draws[0].rows)
    value = float(np.mean([criterion_value(d, d.of(list(chosen)), criterion) for d in draws]))
    # Begun half at the choice, half even: no weight is 0, from which a multiplicative step never
    # rises.
    w = np.full(N, 0.5 * n / N)
    w[list(chosen)] += 0.5
    w = _capped(w, n)
    work = 4.0 * draws[0].rows.size * draws[0].rows.shape[2] * len(draws)
    best, mix, power, before = -np.inf, None, _POWER, np.inf
    for _ in range(int(np.clip(_EFFORT / max(work, 1.0), _FEWEST, _MOST))):
        f, g, mix = _slopes(draws, w, criterion, mix)
        largest = np.partition(g, N - n)[N - n :].sum()
        # The inequality above holds at every w, so the best bound on the way counts.
        best = max(best, f - (float(largest) - float(w @ g)))
        if value - best <= _CLOSE * _scale(value, draws, criterion):
            break
        power = min(_GROWS * power, _STEEPEST) if f < before else _POWER
        mean, before = float(w @ g) / n, f
        w = _capped(w * np.power(np.maximum(g, 1e-12 * mean) / mean, power), n)
    best = min(best, value)
    if criterion == "D":
        q = draws[0].root.shape[1] - draws[0].nuisance.shape[1]
        return Certificate(value, best, float(np.exp((best - value) / max(q, 1))))
    return Certificate(value, best, max(best, 0.0) / value if value > 0.0 else 1.0)


def _scale(value: float, draws: Sequence[Information], criterion: Criterion) -> float:
    return float(draws[0].root.shape[1]) if criterion == "D" else value


def _capped(w: Array, n: int) -> Array:
    """Weights of this proportion, none above 1, that add up to n."""
    w = w * (n / w.sum())
    fixed = np.zeros(len(w), dtype=bool)
    while (over := (w > 1.0) & ~fixed).any():
        fixed |= over
        left = n - int(fixed.sum())
        rest = float(w[~fixed].sum())
        w = np.where(fixed, 1.0, w * (left / rest if rest > 0.0 else 0.0))
    return w


def _slopes(
    draws: Sequence[Information], w: Array, criterion: Criterion, mix: list[Array] | None
) -> tuple[float, Array, list[Array]]:
    """f, g (N,) at weights, and for G the weights of the test poses that make f linear."""
    f, g = 0.0, np.zeros(len(w))
    mixes: list[Array] = []
    for number, d in enumerate(draws):
        flat = d.rows.reshape(-1, d.rows.shape[2])
        each = np.repeat(w, d.rows.shape[1])
        some = each > 0.0
        total = d.start + (flat[some] * each[some, None]).T @ flat[some]
        C = inverse(total)
        if criterion == "D":
            f += criterion_value(d, total, criterion)
            V = d.nuisance
            # The slope of log det(V^T M V), what the nuisance parameters take up of it.
            inner = V @ inverse(V.T @ total @ V) @ V.T if V.shape[1] else 0.0
            H = C - inner
        elif criterion == "G":
            v = test_variances(d, C)
            now = np.full(len(v), 1.0 / len(v)) if mix is None else mix[number]
            now = now * np.exp(_PEAK / (1.0 + _PEAK) * (v / v.max() - 1.0))
            now = now / now.sum()
            mixes.append(now)
            aim = np.einsum("t,tok,tol->kl", now, d.tests, d.tests, optimize=True)
            f += float(now @ v)
            H = C @ aim @ C
        else:
            aim_of = linear_aim(d, criterion)
            assert aim_of is not None
            f += float((C * aim_of).sum())
            H = C @ aim_of @ C
        g += np.einsum("ij,ij->i", flat @ H, flat).reshape(len(w), -1).sum(axis=1)
    return f / len(draws), g / len(draws), mixes
