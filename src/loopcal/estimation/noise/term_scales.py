"""The scales of terms, learnt at one linearisation of the loops, at a cost that no pose adds to.

The whitened equations of all poses E = D dp + v, v ~ N(0, phi I), are known by their sums alone.
Parameters with a flat prior are eliminated once; what is left is S = D^T Q D, s = D^T Q E and
|Q E|^2, Q the projector beside the flat ones. With T the diagonal of the prior sds,

    -2 log L = count log phi + log|K| + residual + sum over terms ((log sd - log median)/spread)^2,

K = 1 + T S T / phi, is minimised over x = (log phi, log sd_b^2 of each term) by its curvature.
With B = K^-1 and w = T^-1 (p - nominal) at the estimate, its derivatives by log sd_b^2 are
m_b - tr B_bb - |w_b|^2, and its second ones sums of squares of blocks of B. One evaluation costs
O(parameters^3). Searle, Casella and McCulloch, Variance Components (1992), chapter 6.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, svd
from loopcal.estimation.noise.linear_model import KEPT, MixedFit
from loopcal.estimation.noise.search import Bounds, search
from loopcal.estimation.solve.reduction import SUMMED_TOLERANCE
from loopcal.lazy import cached_property

if TYPE_CHECKING:
    from collections.abc import Sequence

    from loopcal.mechanisms.terms import Term

# A factor of e in the sd, where the quadratic model of the criterion holds at most. Chosen, not
# derived.
_FARTHEST = 2.0
"""No logarithm of a variance changes by more in one step."""
# Chosen, not derived: logarithms are then off by 2e-5 sds; a further evaluation costs the most.
_SETTLED = 5e-10
"""A step is the last one if it promises the criterion less than this."""
# Chosen, not derived: an sd of 30 in the logarithm of a variance says nothing on it.
_FLAT = 1e-3
"""Curvature below which a direction counts as flat."""
# Chosen, not derived: far below any effect that readings show.
_ABSENT = 1e-6
"""A term with this share of its expected sd has no effect."""


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
class TermFit(MixedFit):
    """The restricted likelihood at some x = (log phi, log sd^2 of each term).

    With the prior of the scales, of which penalties (terms,) are the part in the criterion. The
    information is that of the curvature; freedom: (terms,) degrees of freedom that the data use.
    """

    _: KW_ONLY
    penalties: Array
    freedom: Array

    @property
    def factor(self) -> float:
        """phi."""
        return float(np.exp(self.x[0]))

    @property
    def scales(self) -> Array:
        """The sd of each term."""
        return np.asarray(np.exp(0.5 * self.x[1:]))


@dataclass(frozen=True)
class TermVariances:
    """The terms at one linearisation: the sums that say it, and where the likelihood is greatest.

    free: which of log phi and the logarithms of the variances are learnt, here or beside.
    """

    system: TermSystem
    at: TermFit
    free: NDArray[np.bool_]

    @property
    def scales(self) -> Array:
        """The sd of each term [SI]."""
        return self.at.scales

    @property
    def prior_criterion(self) -> float:
        """What the priors of the terms' parameters and of their scales add to -2 log likelihood."""
        owner = self.system.owner
        volume = 2.0 * float(np.log(self.scales)[owner[owner >= 0]].sum())
        return volume + float(self.at.penalties.sum())

    @property
    def sds(self) -> Array:
        """Of log phi and log sd^2 of each term, by the curvature of the criterion; 0 where held."""
        sds = np.zeros(len(self.at.x))
        index = np.flatnonzero(self.free)
        values, vectors = np.linalg.eigh(2.0 * self.at.information[np.ix_(index, index)])
        # the criterion is -2 log likelihood: its curvature is twice the information
        sds[index] = np.sqrt(np.square(vectors) @ (2.0 / np.maximum(values, _FLAT)))
        return sds

    @cached_property
    def beside_noise(self) -> TermVariances:
        """The same with all noise free to have a factor, which may grow in the place of a term."""
        return searched(self.system, self.at.x, np.ones(len(self.at.x), dtype=bool))

    def without(self, terms: Sequence[int]) -> TermVariances:
        """The fit without these terms, where all else is free."""
        key = tuple(terms)
        if key not in self._without:
            x, others = self.at.x.copy(), np.ones(len(self.at.x), dtype=bool)
            for i in key:
                x[1 + i], others[1 + i] = 2.0 * math.log(_ABSENT * self.system.terms[i].sd), False
            self._without[key] = searched(self.system, x, others)
        return self._without[key]

    @cached_property
    def _without(self) -> dict[tuple[int, ...], TermVariances]:
        return {}


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
        U, values, _ = svd(R[:n, :n] * scale)
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


def evaluate(system: TermSystem, x: Array, _information: Array | None = None) -> TermFit:
    """The likelihood at x = (log phi, log sd^2 of each term), always with its own curvature."""
    from scipy.linalg import lapack

    phi, owner = float(np.exp(x[0])), system.owner
    T = system.prior_sd
    if len(x) > 1:
        T = np.where(owner >= 0, np.exp(0.5 * x[1:])[owner], T)
    m = len(T)
    with np.errstate(over="ignore", invalid="ignore"):  # where the loops have no finite slope
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
    # Of the criterion, -2 log of the likelihood.
    score, information = -0.5 * gradient, 0.5 * hessian
    return TermFit(x, criterion, score, information, penalties=penalties, freedom=freedom)


def _both_halves(sums: Array, diagonal: Array) -> Array:
    """Sums over one half of a symmetric matrix, as over all of it."""
    return np.asarray(sums + sums.T - np.diag(diagonal))


def learn_scales(system: TermSystem, scales: Array, *, common: bool) -> TermVariances:
    """The scales of greatest likelihood, from these on; common: whether phi is learnt too."""
    x = np.concatenate([[0.0], 2.0 * np.log(scales)])
    free = np.arange(len(x)) >= (0 if common else 1)
    return searched(system, x, free)


def searched(system: TermSystem, x: Array, free: NDArray[np.bool_]) -> TermVariances:
    """The greatest likelihood over what is free, from x = (log phi, log sd^2 of each term) on."""
    bounds = Bounds(np.full(len(x), -np.inf), free, _FARTHEST)
    end = search(partial(evaluate, system), evaluate(system, x), bounds, enough=_SETTLED)
    return TermVariances(system, end.at, free)


def _away(terms: Sequence[Term], x: Array) -> Array:
    """log sd - log median of each term."""
    return np.asarray(0.5 * x[1:] - np.log([term.sd for term in terms]))


def _weights(terms: Sequence[Term]) -> Array:
    return np.array([term.spread for term in terms]) ** -2.0
