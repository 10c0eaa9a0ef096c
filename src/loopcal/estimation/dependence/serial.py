"""A covariance that is valid where the errors of an instrument depend on the pose before.

The errors of its readings are taken as white noise and a drift that forgets,

    E_i = D_i dp + X_i u_i + v_i,   v_i ~ N(0, s^2 I),   cov(u_i, u_j) = lambda s^2 rho^|i - j| I,

whose restricted likelihood is evaluated on a grid of lambda and rho, s^2 at its best. The estimate
stays; its covariance is the sandwich H^-1 (D^T V D + P) H^-1, averaged over the grid by likelihood:
a drift that lasts as long as the run is known badly, and its mode alone is too small. H = D^T D + P
with the prior's precision P. rho^|i - j| has a tridiagonal inverse, so each point of the grid costs
one banded decomposition, whatever the number of poses (Rue and Held 2005, chapter 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.dependence.seen import Seen
from loopcal.execution.executor import gathered
from loopcal.execution.forked import process_cores

# From a drift of 3 % of the white variance to one of 1000 times it. A step of half a decade is fine
# beside the likelihood of a variance: chosen, not derived.
_RATIOS = 10.0 ** np.arange(-1.5, 3.1, 0.5)
# Chosen, not derived: some 10 ms, which is what a copy of a process costs.
_LONG = 10_000_000
"""Products of one point of the grid from which on points are evaluated side by side."""
_NOTHING = 1e-6
"""A drift of so small a share of the variance adds nothing."""
_FAR = 20.0
"""A point of the grid whose -2 log likelihood is so far above the best weighs e^-10 of it: what is
beyond such points is not sought."""


@dataclass(frozen=True)
class Whole:
    """All equations in directions z of the parameters with D^T D + P = I.

    DD (k, k), DE (k,), EE: products of D and E; P (k, k): the prior's precision; offset (k,) its
    pull P (nominal - present); square: the prior's own square; equations: how many rows.
    """

    DD: Array
    DE: Array
    EE: float
    P: Array
    offset: Array
    square: float
    equations: int


@dataclass(frozen=True, eq=False)
class Drift:
    """Errors of single readings in units of their sds: white noise and a drift, averaged over the
    grid.

    white: variance of an equation; lengths, sizes: (l,) cov(u_i, u_j) = sum of sizes rho^|i - j|,
    rho = exp(-1 / length); share: of the drift in the variance of a reading; length: number of
    poses over which it forgets (to 1/e).
    """

    white: float
    lengths: Array
    sizes: Array
    share: float
    length: float

    def covariance(self, whole: Whole, seen: Seen) -> Array:
        """(k, k) of z under this drift, (D^T V D + P) where D^T D + P = I."""
        total = self.white + float(self.sizes.sum())
        spread = self.white * whole.DD + whole.P
        for length, size in zip(self.lengths.tolist(), self.sizes.tolist(), strict=True):
            if size > _NOTHING * total:
                spread = spread + size * _correlated(math.exp(-1.0 / length), seen.A)
        return spread


def learnt_drift(whole: Whole, seen: Seen) -> Drift:
    """The drift averaged over the grid; poses of `seen` in the order in which they were read."""
    N = len(seen.y)
    # The shortest keeps exp(-1 / 0.7) = 0.24 from one pose to the next, the longest outlasts
    # the run.
    lengths = np.geomspace(0.7, max(2.0 * N, 4.0), 10)
    columns = np.concatenate([seen.A, seen.y[:, :, None]], axis=2)
    cores = process_cores() if columns.size * columns.shape[2] >= _LONG else None
    shape = len(lengths), len(_RATIOS)
    criteria, s2, waiting = np.full(shape, math.inf), np.ones(shape), np.zeros(shape, dtype=bool)
    waiting[1::3, 1::3] = True
    while waiting.any():
        points = [
            (math.exp(-1.0 / float(lengths[i])), float(_RATIOS[j])) for i, j in np.argwhere(waiting)
        ]
        made = gathered(cores, _criterion, (whole, seen.M, columns), points)
        criteria[waiting], s2[waiting] = np.array(made).T
        likely = np.pad(criteria <= criteria.min() + _FAR, 1)
        beside = np.lib.stride_tricks.sliding_window_view(likely, (3, 3)).any(axis=(2, 3))
        waiting = beside & np.isinf(criteria)
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    weights /= weights.sum()
    share = float((weights @ (_RATIOS / (1.0 + _RATIOS))).sum())
    length = math.exp(float(weights.sum(axis=1) @ np.log(lengths)))
    return Drift(float((weights * s2).sum()), lengths, (weights * s2) @ _RATIOS, share, length)


def _correlated(rho: float, A: Array) -> Array:
    """sum_ij rho^|i - j| A_i^T A_j, (k, k)."""
    from scipy.linalg import solveh_banded

    N, q, k = A.shape
    diagonal, beside = _precision(rho, N)
    filtered = solveh_banded(np.array([np.r_[0.0, beside], diagonal]), A.reshape(N, q * k))
    return np.asarray(A.reshape(N * q, k).T @ filtered.reshape(N * q, k))


def _precision(rho: float, N: int) -> tuple[Array, Array]:
    """Diagonal and what is beside it of the inverse of rho^|i - j|, (N,) and (N - 1,)."""
    diagonal = np.full(N, 1.0 + rho * rho)
    diagonal[[0, -1]] = 1.0
    return diagonal / (1.0 - rho * rho), np.full(N - 1, -rho / (1.0 - rho * rho))


def _criterion(
    shared: tuple[Whole, Array, Array], point: tuple[float, float]
) -> tuple[float, float]:
    """-2 log of the restricted likelihood at the best s^2, and that s^2, for a rho and a ratio."""
    from scipy.linalg import cholesky_banded
    from scipy.linalg.lapack import dtbtrs

    (whole, M, columns), (rho, ratio) = shared, point
    N, q, _ = columns.shape
    diagonal, beside = _precision(rho, N)
    band = np.zeros((q + 1, N * q))
    band[q] = np.repeat(diagonal / ratio, q)
    band[0, q:] = np.repeat(beside / ratio, q)
    for above in range(q):  # entries (j - above, j) of the block of each pose
        for j in range(above, q):
            band[q - above, j::q] += M[:, j - above, j]
    factor = cholesky_banded(band)
    log_V = 2.0 * float(np.log(factor[q]).sum())
    # |1 + X R X^T| = |R| |R^-1 + M| (Sylvester), R = ratio rho^|i - j|; the determinant of
    # rho^|i - j| is (1 - rho^2)^(N - 1).
    log_V += N * q * math.log(ratio) + q * (N - 1) * math.log1p(-rho * rho)
    flat = columns.reshape(N * q, -1)
    # Woodbury's identity: V^-1 needs only the inverse of the band R^-1 + M = U^T U.
    solved, _ = dtbtrs(factor, flat, uplo="U", trans="T")
    taken = solved.T @ solved
    s2, criterion = _at_the_best(
        whole, whole.DD - taken[:-1, :-1], whole.DE - taken[:-1, -1], whole.EE - taken[-1, -1]
    )
    return log_V + criterion, s2


def _at_the_best(whole: Whole, DD: Array, DE: Array, EE: float) -> tuple[float, float]:
    """The s^2 of largest restricted likelihood, and -2 log of it there but for log|V / s^2|.

    DD, DE, EE: products of D and E weighted by s^2 V^-1.
    """
    from scipy.linalg import eigh

    # Directions with D^T D = diag(d) and P = 1 - diag(d): there every s^2 costs O(k).
    both = DD + whole.P
    d, directions = eigh(DD, both, driver="gvd", check_finite=False)
    d = np.clip(d, 0.0, 1.0)
    a, b = directions.T @ DE, directions.T @ whole.offset
    s2 = 1.0
    for _ in range(50):
        h = d / s2 + 1.0 - d
        y = (a / s2 + b) / h
        square = EE - 2.0 * (y @ a) + y @ (d * y)
        used = float(np.sum(d / h)) / s2
        new = max(float(square), 1e-300) / max(whole.equations - used, 1.0)
        if abs(new - s2) <= 1e-6 * s2:
            break
        s2 = new
    h, g = d / s2 + 1.0 - d, a / s2 + b
    left = EE / s2 + whole.square - float(g @ (g / h))
    log_H = float(np.linalg.slogdet(both)[1]) + float(np.log(h).sum())
    return s2, whole.equations * math.log(s2) + log_H + left
