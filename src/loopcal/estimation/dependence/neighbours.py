"""Whether residuals of neighbouring poses are alike: neighbours in order, or in joint space.

For pairs of neighbours (i, j) the statistic is

    r = sum over pairs of y_i . y_j / (|E|^2 + prior),

von Neumann's ratio (1941) where neighbours follow each other, Moran's I (1950) where they are near
in joint space. It is the score test of a component that neighbours share. The fit has taken part of
the residuals; the moments of r allow for it exactly (Durbin and Watson 1950): with M the projector
onto what is left, nu its rank and K the pairs as a matrix,

    E r = tr MK / nu,   Var r = 2 (nu tr (MK)^2 - (tr MK)^2) / (nu^2 (nu + 2)).

Errors of unlike size or direction, such as those of an arm that bends, scatter r more: the variance
is at least sum (y_i . y_j)^2 / (|E|^2 + prior)^2, right for independent errors of any kind.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from loopcal.document.dependence import Likeness
from loopcal.estimation.dependence.seen import Seen

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]
# Chosen, not derived: with fewer, the normal distribution of Moran's I is not to be believed.
_LEAST = 10
"""Degrees of freedom and pairs that a test needs at least."""


def in_order(seen: Seen) -> Pairs:
    """(2, p) the poses that follow each other among those that were read."""
    read = np.flatnonzero(seen.read)
    return np.array([read[:-1], read[1:]])


def likeness(seen: Seen, pairs: Pairs, square: float, freedom: int) -> Likeness | None:
    """The test for these pairs; None where there is too little to test.

    seen: in directions z of the parameters with D^T D + P = I; square: |E|^2 and that of the prior;
    freedom: nu.
    """
    i, j = pairs[:, seen.read[pairs].all(axis=0)]
    if freedom < _LEAST or len(i) < _LEAST or not square > 0.0:
        return None
    y, A, M = seen.y, seen.A, seen.M
    products = np.einsum("pq,pq->p", y[i], y[j])
    total = float(products.sum())
    near = np.zeros_like(A)
    # A pose may be in many pairs; near[i] += would count only the last of them.
    np.add.at(near, i, 0.5 * A[j])
    np.add.at(near, j, 0.5 * A[i])
    N, q, k = A.shape
    once = A.reshape(N * q, k).T @ near.reshape(N * q, k)
    twice = float(np.einsum("nqi,nqi->", near, M @ near))
    # M = 1 - D D^T, and K pairs different poses: of tr MK only -tr D^T K D is left.
    trace = -float(np.trace(once))
    # tr (MK)^2 = tr K^2 - 2 tr D^T K^2 D + tr (D^T K D)^2; a pair is in K twice, as 1/2.
    squared = 0.5 * float(np.einsum("pqr,prq->", M[i], M[j])) - 2.0 * twice
    squared += float(np.square(once).sum())
    variance = 2.0 * (freedom * squared - trace**2) / (freedom**2 * (freedom + 2.0))
    variance = max(variance, float(products @ products) / square**2)
    if not variance > 0.0:
        return None
    deviate = (total / square - trace / freedom) / math.sqrt(variance)
    mean_square = float(np.einsum("nq,nq->", y, y)) / int(seen.read.sum())
    correlation = total / len(i) / mean_square if mean_square > 0.0 else 0.0
    # One-sided: errors that neighbours share make residuals alike, never unlike.
    return Likeness(correlation, 0.5 * math.erfc(deviate / math.sqrt(2.0)))


def near(points: Array, neighbours: int = 6, apart: int = 0) -> Pairs:
    """(2, p) pairs of poses that are nearest to each other at points (N, d).

    apart: poses that follow each other within so many are no pair. A drift along a path is then
    not taken for a place in joint space.
    """
    N = len(points)
    if 2 * apart + 2 >= N:
        return np.zeros((2, 0), dtype=np.intp)
    squares = np.square(points).sum(axis=1)
    distance = squares[:, None] + squares - 2.0 * points @ points.T
    rows = np.arange(N)
    distance[np.abs(rows[:, None] - rows) <= apart] = np.inf
    nearest = np.argpartition(distance, min(neighbours, N - 1), axis=1)[:, :neighbours]
    both = np.sort(np.array([np.repeat(rows, nearest.shape[1]), nearest.ravel()]), axis=0)
    kept = np.isfinite(distance[both[0], both[1]])
    pairs: Pairs = np.array(np.divmod(np.unique(both[0, kept] * N + both[1, kept]), N))
    return pairs
