"""The scales of terms, learnt at one linearisation of the loops, at a cost that no pose adds to.

The whitened equations of all poses E = D dp + v, v ~ N(0, phi I), are known by their sums alone.
Parameters with a flat prior are eliminated once; what is left is S = D^T Q D, s = D^T Q E and
|Q E|^2, Q the projector beside the flat ones. With T the diagonal of the prior sds,

    -2 log L = count log phi + log|K| + residual + sum over terms ((log sd - log median)/spread)^2,

K = 1 + T S T / phi, is minimised over x = (log phi, log sd_b^2 of each term) by Newton's method.
With B = K^-1 and w = T^-1 (p - nominal) at the estimate, its derivatives by log sd_b^2 are
m_b - tr B_bb - |w_b|^2, and its second ones sums of squares of blocks of B. One evaluation costs
O(parameters^3). Searle, Casella and McCulloch, Variance Components (1992), chapter 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.linear_model import KEPT
from loopcal.estimation.solve.reduction import SUMMED_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from loopcal.mechanisms.terms import Term

Array = NDArray[np.float64]
# Caps against an endless search: 30 halvings leave 1e-9 of a step. Chosen, not derived.
_MOST, _HALVINGS = 60, 30
_SETTLED, _ROUNDING = 1e-9, 1e-14
"""A step is the last one if it promises the criterion less than this, or than its rounding."""
# A factor of e in the sd, where the quadratic model of the criterion holds at most. Chosen, not
# derived.
_FARTHEST = 2.0
"""No logarithm of a variance changes by more in one step."""
# Chosen, not derived: an sd of 30 in the logarithm of a variance says nothing on it.
_FLAT = 1e-3
"""Curvature below which a direction counts as flat."""


@dataclass(frozen=True)
class TermSystem:
    """The sums over all poses with the flat parameters eliminated.

    S: (m, m), s: (m,), square: |Q E|^2; count: equations less the flat directions; volume: log
    of the determinant of the eliminated block; prior_sd, offset = nominal - present: (m,), of the
    parameters that have a prior; owner: (m,) the term that each is in, -1 if none.
    """

    S: Array
    s: Array
    square: float
    count: int
    volume: float
    prior_sd: Array
    offset: Array
    owner: NDArray[np.intp]
    terms: tuple[Term, ...]

    @property
    def members(self) -> Array:
        """(terms, m): which parameters are in which term."""
        return np.equal.outer(np.arange(len(self.terms)), self.owner).astype(float)


@dataclass(frozen=True)
class Sums:
    """[D E]^T [D E] of all poses: as it is, or its triangle; equations: how many."""

    total: Array
    triangular: bool
    equations: int


@dataclass(frozen=True)
class Start:
    """Where a search begins, x = (log phi, log sd^2 of each term), and which of these are free."""

    x: Array
    free: NDArray[np.bool_]


@dataclass(frozen=True)
class TermFit:
    """The criterion at some x = (log phi, log sd^2 of each term).

    criterion: -2 log of the restricted likelihood with the prior of the scales, up to a constant;
    gradient, hessian: its derivatives by x; freedom: (terms,) degrees of freedom that the data use.
    """

    x: Array
    criterion: float
    penalties: Array
    gradient: Array
    hessian: Array
    freedom: Array

    @property
    def factor(self) -> float:
        """phi."""
        return float(np.exp(self.x[0]))

    @property
    def scales(self) -> Array:
        """The sd of each term."""
        return np.asarray(np.exp(0.5 * self.x[1:]))


def term_system(
    sums: Sums, prior_sd: Array, offset: Array, owner: NDArray[np.intp], terms: Sequence[Term]
) -> TermSystem:
    """The sums over all poses with flat parameters eliminated.

    prior_sd, offset, owner: (n,) of all estimated parameters.
    """
    flat = np.isinf(prior_sd)
    order = np.concatenate([np.flatnonzero(flat), np.flatnonzero(~flat)])
    n, informed = int(flat.sum()), ~flat
    which = np.append(order, len(prior_sd))
    rows = sums.total[:, which] if sums.triangular else sums.total[np.ix_(which, which)]
    if sums.triangular:
        R = np.asarray(np.linalg.qr(rows, mode="r") if n else rows)
        scale = 1.0 / np.maximum(np.linalg.norm(R[:n, :n], axis=0), 1e-150)
        U, values, _ = np.linalg.svd(R[:n, :n] * scale)
        kept = values > KEPT * values.max(initial=0.0)
        along = U[:, kept].T @ R[:n, n:]
        rest = np.vstack([R[:n, n:] - U[:, kept] @ along, R[n:, n:]])
        products = rest.T @ rest
    else:
        A = rows[:n, :n]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        squares, vectors = np.linalg.eigh(A * np.outer(scale, scale))
        values = np.sqrt(np.maximum(squares, 0.0))
        kept = values > SUMMED_TOLERANCE * values.max(initial=0.0)
        along = (vectors[:, kept] / values[kept]).T @ (scale[:, None] * rows[:n, n:])
        products = rows[n:, n:] - along.T @ along
    # log|A| of the block as scaled, less what scaling its rows and columns has added.
    volume = 2.0 * float(np.log(values[kept]).sum() - np.log(scale).sum())
    return TermSystem(
        products[:-1, :-1],
        products[:-1, -1],
        max(float(products[-1, -1]), 0.0),
        sums.equations - int(kept.sum()),
        volume,
        prior_sd[informed],
        offset[informed],
        owner[informed],
        tuple(terms),
    )


def _root(K: Array) -> Array:
    """L, lower triangular, with L L^T = K, no eigenvalue of which is below 1."""
    from scipy.linalg import lapack

    factor, failed = lapack.dpotrf(K.T, lower=1)
    if not failed:
        return np.asarray(factor, dtype=np.float64)
    # rounding hides the 1 beside eigenvalues of 1e16
    values, vectors = np.linalg.eigh(K)
    R = np.linalg.qr(np.sqrt(np.maximum(values, 1.0))[:, None] * vectors.T, mode="r")
    turned: Array = (R * np.sign(np.diag(R))[:, None]).T
    return turned


def evaluate(system: TermSystem, x: Array) -> TermFit:
    """The criterion and its derivatives at x = (log phi, log sd^2 of each term)."""
    from scipy.linalg import lapack

    phi, owner = float(np.exp(x[0])), system.owner
    T = (
        np.where(owner >= 0, np.exp(0.5 * x[1:])[owner], system.prior_sd)
        if len(x) > 1
        else (system.prior_sd)
    )
    m = len(T)
    K = system.S * (T / phi)
    K *= T[:, None]
    K.reshape(-1)[:: m + 1] += 1.0
    factor = _root(K) if m else K
    log_K = 2.0 * float(np.log(np.diag(factor)).sum())
    half = lapack.dpotri(factor, lower=1)[0] if m else K  # of B; the rest is zero
    diagonal = np.diag(half)

    def times_B(z: Array) -> Array:
        return np.asarray(half @ z + half.T @ z - diagonal * z)

    w = times_B(T * (system.s - system.S @ system.offset)) / phi
    dp = T * w + system.offset
    misfit = system.square - 2.0 * float(dp @ system.s) + float(dp @ system.S @ dp)
    residual = max(misfit, 0.0) / phi
    away, weight = _away(system.terms, x), _weights(system.terms)
    squares = np.square(w)
    members = system.members
    by_half, Bw = np.square(half), times_B(w)
    by_column = by_half.sum(axis=0) + by_half.sum(axis=1) - np.square(diagonal)
    # a parameter is in one term: the diagonal, which both halves hold, is in blocks of one term
    blocks = _both_halves(members @ by_half @ members.T, members @ np.square(diagonal))
    cross = _both_halves((members * w) @ half @ (members * w).T, members @ (diagonal * squares))
    traces = members @ diagonal
    weighed = members @ squares
    c = len(system.terms)
    gradient, hessian = np.zeros(c + 1), np.zeros((c + 1, c + 1))
    gradient[0] = system.count - (m - diagonal.sum()) - residual
    gradient[1:] = members.sum(axis=1) - traces - weighed + away * weight
    hessian[0, 0] = diagonal.sum() - by_column.sum() + residual - 2.0 * float(w @ Bw)
    hessian[0, 1:] = members @ (by_column - diagonal + 2.0 * w * Bw)
    hessian[1:, 0] = hessian[0, 1:]
    hessian[1:, 1:] = np.diag(traces + weighed + 0.5 * weight) - blocks - 2.0 * cross
    penalties = np.square(away) * weight
    criterion = system.count * float(x[0]) + system.volume + log_K + residual
    criterion += float(squares.sum() + penalties.sum())
    # tr (1 - B_bb): a parameter that only its prior determines has B = 1 and counts nothing.
    freedom = members.sum(axis=1) - traces
    return TermFit(x, criterion, penalties, gradient, hessian, freedom)


def _both_halves(sums: Array, diagonal: Array) -> Array:
    """Sums over one half of a symmetric matrix, as over all of it."""
    return np.asarray(sums + sums.T - np.diag(diagonal))


def learn_scales(system: TermSystem, start: Start) -> TermFit:
    """The least criterion over what is free, from the start on."""
    current = evaluate(system, start.x)
    for _ in range(_MOST):
        step = _newton_step(current, start.free)
        slope = float(step @ current.gradient)
        if -slope <= _SETTLED + _ROUNDING * abs(current.criterion):
            break
        length = min(1.0, _FARTHEST / float(np.abs(step).max()))
        for _ in range(_HALVINGS):
            trial = evaluate(system, current.x + length * step)
            # Sufficient decrease (Armijo 1966) with the 1e-4 of Nocedal and Wright (2006), 3.1.
            if trial.criterion < current.criterion + 1e-4 * length * slope:
                break
            length /= 2
        else:
            break
        current = trial
    return current


def begun(scales: Array, *, common: bool) -> Start:
    """Where the search for the scales begins; common: whether the factor of all noise is free."""
    free = np.ones(len(scales) + 1, dtype=bool)
    free[0] = common
    return Start(np.concatenate([[0.0], 2.0 * np.log(scales)]), free)


def _newton_step(at: TermFit, free: NDArray[np.bool_]) -> Array:
    """Newton's step; where the criterion curves downwards, down along the slope."""
    step = np.zeros(len(at.x))
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(at.hessian[np.ix_(index, index)])
    along = vectors.T @ at.gradient[index]
    step[index] = -vectors @ (along / np.maximum(np.abs(values), _FLAT))
    return step


def _away(terms: Sequence[Term], x: Array) -> Array:
    """log sd - log median of each term."""
    return np.asarray(0.5 * x[1:] - np.log([term.sd for term in terms]))


def _weights(terms: Sequence[Term]) -> Array:
    return np.array([term.spread for term in terms]) ** -2.0
