"""Covariances whose own size was learnt from few readings: t instead of normal, F instead of chi^2.

A covariance Phi(s) that depends on learnt variances s is itself uncertain. Let D_a be its changes
per sd of each independent error of s. The variance v = l^T Phi l of a combination then has itself
the variance sum_a (l^T D_a l)^2. That is the variance of a multiple of chi-squared with

    nu = 2 v^2 / sum_a (l^T D_a l)^2

degrees of freedom (Satterthwaite 1946), which are those of Student's t of that combination. A
quadratic form of several combinations has F. Its denominator follows from the nu_i of independent
ones: E = sum_i nu_i / (nu_i - 2), m = 2 E / (E - l) (Fai and Cornelius 1996). Known variances have
no D_a: then nu and m are infinite, t is normal and F is chi-squared over its degrees of freedom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile, tail

_FEWEST = 2.2
"""Degrees of freedom of one combination, at least: below 2 the mean of its square has no bound."""
# Of the largest eigenvalue: directions below are rounding of a singular covariance.
_RANK = 1e-12


@dataclass(frozen=True, eq=False)
class LearntCovariance:
    """A covariance (..., n, n) of estimates, and how sure it is itself.

    matrix: to be used, with what learning the variances adds; plain: as if these were known;
    slopes: (a, ..., n, n) changes of `plain` per sd of each independent error of the variances.
    """

    def __repr__(self) -> str:
        return f"<LearntCovariance of shape {self.matrix.shape}>"

    matrix: Array
    plain: Array
    slopes: Array

    @classmethod
    def certain(cls, matrix: Array) -> LearntCovariance:
        """A covariance from variances that are known."""
        return cls(matrix, matrix, np.zeros((0, *matrix.shape)))

    @classmethod
    def scaled(cls, matrix: Array, freedom: float) -> LearntCovariance:
        """A covariance known up to a factor, which was estimated with `freedom` degrees."""
        return cls(matrix, matrix, math.sqrt(2.0 / freedom) * matrix[None])

    def through(self, S: Array) -> LearntCovariance:
        """Of S times the estimates, S (..., m, n)."""
        if not np.isfinite(self.matrix).all():  # nothing is known of any
            return LearntCovariance.certain(np.full((*S.shape[:-1], S.shape[-2]), np.inf))
        turned = np.swapaxes(S, -1, -2)
        extended = self.slopes.reshape(len(self.slopes), *(1,) * (S.ndim - 2), *self.plain.shape)
        return LearntCovariance(
            S @ self.matrix @ turned, S @ self.plain @ turned, S @ extended @ turned
        )

    def within(self, size: int, index: NDArray[np.intp]) -> LearntCovariance:
        """As part of a vector of this size, of which nothing else is uncertain."""

        def spread(part: Array) -> Array:
            whole = np.zeros((*part.shape[:-2], size, size))
            whole[(..., index[:, None], index)] = part
            return whole

        return LearntCovariance(spread(self.matrix), spread(self.plain), spread(self.slopes))

    def plus(self, other: LearntCovariance) -> LearntCovariance:
        """Of the sum of two estimates whose variances have the same errors."""
        return LearntCovariance(
            self.matrix + other.matrix, self.plain + other.plain, self.slopes + other.slopes
        )

    def scaled_by(self, factor: float) -> LearntCovariance:
        """Multiplied by a number."""
        return LearntCovariance(factor * self.matrix, factor * self.plain, factor * self.slopes)

    def less(self, part: Array | None) -> LearntCovariance:
        """Without this part of `matrix`, whose size errs along the last of `slopes`."""
        if part is None:
            return self
        slopes = self.slopes.copy()
        slopes[-1:] = 0.0
        return LearntCovariance(self.matrix - part, self.plain, slopes)

    def widened(self, part: Array, spread: float = 0.0) -> LearntCovariance:
        """With this part besides, whose size has that relative sd along the last of `slopes`."""
        slopes = self.slopes.copy()
        slopes[-1:] += spread * part
        return LearntCovariance(self.matrix + part, self.plain + part, slopes)

    def besides(self, part: Array, spread: float) -> LearntCovariance:
        """Add a part to `matrix` alone, with its own last slope. `less` removes it again."""
        slopes = np.concatenate([self.slopes, spread * part[None]])
        return LearntCovariance(self.matrix + part, self.plain, slopes)

    def of(self, index: NDArray[np.intp]) -> LearntCovariance:
        """Of some of the estimates."""
        at = (..., index[:, None], index)
        return LearntCovariance(self.matrix[at], self.plain[at], self.slopes[at])

    @property
    def freedom(self) -> Array:
        """(..., n) degrees of freedom of Student's t of each estimate; inf: normal.

        At least that of an sd from one redundant reading: Satterthwaite's ratio falls below it
        where sizes are hardly learnt, whose log-normal priors have lighter tails than such a t.
        """
        variance = np.einsum("...ii->...i", self.plain)
        changes = np.square(np.einsum("...ii->...i", self.slopes)).sum(axis=0)
        return np.maximum(_satterthwaite(variance, changes), 1.0)

    @property
    def denominator(self) -> Array:
        """(...) degrees of freedom of the denominator of F of all estimates; inf: chi-squared."""
        size = self.plain.shape[-1]
        if not len(self.slopes) or not size:
            return np.full(self.plain.shape[:-2], math.inf)
        usable = np.asarray(np.isfinite(self.plain).all(axis=(-2, -1)))[..., None, None]
        plain, slopes = (np.where(usable, part, 0.0) for part in (self.plain, self.slopes))
        variance = np.einsum("...ii->...i", plain)
        # Metres beside radians: unit variances keep the eigenvalues comparable.
        scale = 1.0 / np.sqrt(np.where(variance > 0.0, variance, 1.0))
        eigenvalues, vectors = np.linalg.eigh(plain * scale[..., None] * scale[..., None, :])
        kept = eigenvalues > _RANK * np.maximum(eigenvalues[..., -1:], 1e-300)
        white = scale[..., None] * vectors / np.sqrt(np.where(kept, eigenvalues, 1.0))[..., None, :]
        white = np.where(kept[..., None, :], white, 0.0)
        Z = np.swapaxes(white, -1, -2) @ slopes @ white
        # Axes that make the slopes as diagonal as can be: the combinations along them are
        # independent.
        _, axes = np.linalg.eigh((Z @ Z).sum(axis=0))
        along = np.einsum("...ji,a...jk,...ki->a...i", axes, Z, axes)
        nu = np.maximum(
            _satterthwaite(np.ones(eigenvalues.shape), np.square(along).sum(axis=0)), _FEWEST
        )
        mean = (1.0 / (1.0 - 2.0 / nu)).sum(axis=-1)
        excess = mean - size
        return np.where(excess > 1e-9, 2.0 * mean / np.where(excess > 1e-9, excess, 1.0), math.inf)


def contrasts(C: LearntCovariance, left_out: Array) -> Array:
    """(q, n) contrasts of unit variance under C that feel nothing of these directions."""
    sd = np.sqrt(np.maximum(np.diag(C.matrix), 0.0))
    fixed = sd == 0.0  # in both: not what the calibrations say
    scale = np.where(fixed, 1.0, sd)
    directions = left_out / scale[:, None]
    # Directions of length 1, so that the cut below counts them and not their units.
    directions = directions / np.maximum(np.linalg.norm(directions, axis=0), 1e-300)
    U, s, _ = np.linalg.svd(np.hstack([directions, np.zeros((len(sd), 1))]))
    K = U[:, int((s > 1e-9).sum()) :].T / scale
    values, vectors = np.linalg.eigh(C.through(K).matrix)
    kept = values > _RANK * max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T @ K)


def _satterthwaite(variance: Array, changes: Array) -> Array:
    certain = changes <= 1e-12 * np.square(variance)
    return np.where(certain, math.inf, 2.0 * np.square(variance) / np.where(certain, 1.0, changes))


def t_quantile(level: float, freedom: float) -> float:
    """The t within +- which a share `level` of Student's t lies; normal at infinite freedom.

    >>> round(t_quantile(0.95, float("inf")), 6), round(t_quantile(0.95, 4.0), 6)
    (1.959964, 2.776445)
    """
    from scipy.special import ndtri, stdtrit

    upper = 0.5 + 0.5 * level
    return float(ndtri(upper) if math.isinf(freedom) else stdtrit(freedom, upper))


def f_tail(square: float, size: int, denominator: float) -> float:
    """Probability of a quadratic form of `size` combinations at least this large.

    >>> round(f_tail(3.841458820694124, 1, float("inf")), 12)
    0.05
    """
    if math.isinf(denominator):
        return tail(square, size)
    from scipy.special import fdtrc

    return float(fdtrc(size, denominator, square / size))


def f_limit(level: float, size: int, denominator: Array) -> Array:
    """The quadratic form of `size` combinations within which a share `level` lies."""
    certain = np.isinf(denominator)
    limit = np.full(denominator.shape, quantile(1.0 - level, size))
    if certain.all():
        return limit
    from scipy.special import fdtri

    few = np.where(certain, 1.0, denominator)
    return np.asarray(np.where(certain, limit, size * fdtri(size, few, level)))
