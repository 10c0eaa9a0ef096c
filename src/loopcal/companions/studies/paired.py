"""Two methods on the same draws: how often one is closer, and the ratio of their rms errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array

# 25 resamples beyond each quantile of 2.5 %; Efron and Tibshirani (1993) use 1000 for intervals.
RESAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class Advantage:
    """One error of two methods on the same draws.

    closer: share of draws in which the first method's is the smaller, ties counting half to
    either, with its exact binomial 95 % interval (Clopper and Pearson 1934); ratio: rms error of
    the first over that of the second, with its 95 % bootstrap interval over draws (Efron 1979);
    None where the second makes no error.
    """

    name: str
    closer: float
    closer_low: float
    closer_high: float
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None


@dataclass(frozen=True)
class Paired:
    """The first method against the second over the draws in which both converged."""

    methods: tuple[str, str]
    draws: int
    advantages: tuple[Advantage, ...]


def paired(
    methods: tuple[str, str], names: tuple[str, ...], errors: tuple[Array, Array], *, seed: int
) -> Paired:
    """Compare two methods draw by draw.

    errors: of each, (draws, names) [SI], NaN where a fit did not converge; seed: of the resampling.
    """
    both = np.isfinite(errors[0]).all(axis=1) & np.isfinite(errors[1]).all(axis=1)
    first, second = (np.abs(e[both]) for e in errors)
    draws = len(first)
    if not draws:
        return Paired(methods, 0, ())
    wins = np.sum(first < second, axis=0) + 0.5 * np.sum(first == second, axis=0)
    squares = np.column_stack([np.square(first), np.square(second)])
    ratios = _ratio(squares.mean(axis=0))
    low, high = _bootstrap(squares, seed)
    advantages = []
    for i, name in enumerate(names):
        closer_low, closer_high = binomial_interval(float(wins[i]), draws)
        finite = bool(np.isfinite(ratios[i]) and np.isfinite(low[i]) and np.isfinite(high[i]))
        advantages.append(
            Advantage(
                name,
                float(wins[i]) / draws,
                closer_low,
                closer_high,
                float(ratios[i]) if finite else None,
                float(low[i]) if finite else None,
                float(high[i]) if finite else None,
            )
        )
    return Paired(methods, draws, tuple(advantages))


def binomial_interval(wins: float, draws: int) -> tuple[float, float]:
    """The exact interval of the probability of a win (Clopper-Pearson).

    >>> [round(end, 3) for end in binomial_interval(970, 1000)]
    [0.957, 0.98]
    """
    from scipy.special import betaincinv

    tail = (1.0 - LEVEL) / 2.0
    low = betaincinv(wins, draws - wins + 1.0, tail) if wins > 0 else 0.0
    high = betaincinv(wins + 1.0, draws - wins, 1.0 - tail) if wins < draws else 1.0
    return float(low), float(high)


def _ratio(mean_squares: Array) -> Array:
    half = mean_squares.shape[-1] // 2
    first, second = mean_squares[..., :half], mean_squares[..., half:]
    safe = np.where(second > 0.0, second, 1.0)
    return np.asarray(np.where(second > 0.0, np.sqrt(first / safe), np.nan), dtype=np.float64)


def _bootstrap(squares: Array, seed: int) -> tuple[Array, Array]:
    """Quantiles (c,) of the ratios of rms errors over resampled draws."""
    rng = np.random.Generator(np.random.PCG64(seed))
    draws = len(squares)
    ratios = []
    for _ in range(RESAMPLES):
        # A resample is how often each draw is taken; its means follow from one product.
        counts = np.bincount(rng.integers(0, draws, draws), minlength=draws)
        ratios.append(_ratio(counts @ squares / draws))
    tail = (1.0 - LEVEL) / 2.0
    low, high = np.quantile(np.array(ratios), (tail, 1.0 - tail), axis=0)
    return low, high
