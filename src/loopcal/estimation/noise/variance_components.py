"""Variance components: the sds of sensors, learnt from the calibration itself.

Restricted maximum likelihood (Patterson and Thompson 1971) by Fisher scoring on the variance
ratios, at one linearisation of the loops; the calibration refits in between until both settle.
No ratio is negative: each step is the best one that keeps them so, hence a ratio reaches zero, or
leaves it, when the likelihood says so (Karush, Kuhn and Tucker), whatever the sds stated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.noise.linear_model import LinearModel, MixedFit, fit
from loopcal.lazy import cached_property

Array = NDArray[np.float64]
# Caps against an endless search: 30 halvings leave 1e-9 of a step. Chosen, not derived.
_MOST, _HALVINGS = 200, 30
_SETTLED = 1e-10
"""A step is the last one if it promises the criterion less than this, or than its rounding."""
_ROUNDING = 1e-14
"""Of the criterion's size, so much is rounding."""
_AT_BOUND = 1e-9
"""A step that leaves no more than this of a ratio above its bound leads to the bound."""
# Above rounding, 1e-16, and far below any information that counts: chosen, not derived.
_RIDGE = 1e-12
"""Of a component's own information, so that what only shows in a sum has a step of its own."""
# Chosen, not derived: an sd of 100 in the logarithm says nothing on the ratio.
_OPEN = 1e-4
"""Information on the logarithm of a ratio, below which the data leave it open."""
# Chosen, not derived: by chance alone chi-squared is larger in three cases of four.
_NO_PULL = 0.1
"""Chi-squared with which the data hold a ratio at zero, below which it is there by chance."""
# Chosen, not derived: only a tenth of the variance of each, 1 - 0.95^2, is its own.
ALIKE = 0.95
"""Two estimates correlated beyond this cannot be separated by the data."""


@dataclass(frozen=True)
class Component:
    """A set of quantities whose sds are known up to one common factor, which is estimated."""

    name: str
    quantities: tuple[int, ...]


@dataclass(frozen=True)
class Estimate:
    """Variance ratios (c,) to the stated sds, and the likelihood there."""

    ratios: Array
    at: MixedFit
    converged: bool

    @property
    def criterion(self) -> float:
        """-2 log of the restricted likelihood, up to a constant."""
        return self.at.criterion

    @cached_property
    def covariance(self) -> Array:
        """Covariance (c, c) of the ratios.

        A ratio at zero has none (see `variance_bounds`), unless it is there by chance: part of a
        sum that could as well be all its own.
        """
        return self._inverse((self.ratios > 0.0) | self._by_chance)

    @property
    def alike(self) -> tuple[tuple[int, int], ...]:
        """Pairs of components so correlated that these data cannot separate them."""
        pairs = np.argwhere(np.tril(_correlated(self.covariance), -1))
        return tuple((int(j), int(i)) for i, j in pairs)

    @cached_property
    def _by_chance(self) -> NDArray[np.bool_]:
        """Ratios at zero that the likelihood lets rise at the cost of another's."""
        everything = self._inverse(np.diag(self.at.information) > 0.0)
        pull = np.square(self.at.score) * np.diag(everything)
        flat: NDArray[np.bool_] = (self.ratios == 0.0) & (pull < _NO_PULL)
        return flat & _correlated(everything).any(axis=1)

    def _inverse(self, which: NDArray[np.bool_]) -> Array:
        """The inverse information on some of the ratios, scaled to logarithms; else zero."""
        covariance = np.zeros_like(self.at.information)
        index = np.flatnonzero(which)
        if not index.size:
            return covariance
        information = self.at.information[np.ix_(index, index)]
        present, root = self.ratios[index], np.sqrt(np.diag(information))
        # a ratio at zero counts as what would make up for the largest other
        most = float((present * root).max()) or 1.0
        scale = np.where(present > 0.0, present, most / np.maximum(root, 1e-150))
        values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
        # what only shows in a sum is left open by the data: almost no information on it
        values = np.maximum(values, _OPEN / 10.0)
        root = scale[:, None] * vectors / np.sqrt(values)
        covariance[np.ix_(index, index)] = root @ root.T
        return covariance

    def sd_of_root(self, which: int) -> float | None:
        """Sd of the root of a ratio, to first order; None at zero, or if data leave it open."""
        ratio, variance = float(self.ratios[which]), float(self.covariance[which, which])
        if ratio == 0.0 or variance > ratio * ratio / _OPEN:
            return None
        return 0.5 * math.sqrt(variance / ratio)


def estimate_ratios(
    model: LinearModel,
    start: Array | None = None,
    *,
    lowest: Array | None = None,
) -> Estimate:
    """The variance ratios of greatest restricted likelihood.

    start: where the search begins, by default at the stated sds; lowest: (c,) what no ratio falls
    below, by default zero.

    Raises NoTrustworthyResult where the loops have no noise at the start nor at the stated sds.
    """
    ratios = np.ones(model.components) if start is None else np.array(start)
    lowest = np.zeros(model.components) if lowest is None else lowest
    free = np.ones(model.components, dtype=bool)
    current = fit(model, ratios)
    if current is None:
        ratios = np.ones(model.components)
        current = fit(model, ratios)
    if current is None:
        raise NoTrustworthyResult(
            "the sds cannot be estimated: the loops have no usable noise model where the fit ended",
            remedy="calibrate with stated sds first and check that the fit converges",
        )
    for _ in range(_MOST):
        step = scoring_step(current, ratios, lowest, free)
        promised = float(step @ (2.0 * current.score - current.information @ step))
        if promised <= _SETTLED + _ROUNDING * abs(current.criterion):
            break
        moved = _improved(model, ratios, step, current)
        if moved is None:
            break
        ratios, current = moved
    else:
        return Estimate(ratios, current, False)
    # what goes to its bound is there, however little is left to gain by it
    ended = np.where(ratios + step <= lowest + _AT_BOUND * ratios, lowest, ratios)
    last = current if np.array_equal(ended, ratios) else fit(model, ended)
    return Estimate(ratios, current, True) if last is None else Estimate(ended, last, True)


def scoring_step(current: MixedFit, ratios: Array, lowest: Array, free: NDArray[np.bool_]) -> Array:
    """Fisher's step d, the greatest of score d - d I d / 2 where no ratio falls below the lowest.

    With I = A^T A and u = ratios + d - lowest it is the least |A u - b| over u >= 0.
    """
    step = np.zeros_like(ratios)
    diagonal = np.diag(current.information)
    index = np.flatnonzero(free & (diagonal > 0.0))
    if not index.size:
        return step
    scale = 1.0 / np.sqrt(diagonal[index])
    information = current.information[np.ix_(index, index)] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, _RIDGE))
    # A^T b = score + information above: the slope, at u = 0, of what the step makes greatest.
    A = root[:, None] * vectors.T
    above = (ratios - lowest)[index] / scale
    b = A @ above + (vectors.T @ (current.score[index] * scale)) / root
    # u - above may round to just below -above, which would leave a ratio below its bound.
    step[index] = np.maximum(_least_above_zero(A, b) - above, -above) * scale
    return step


def _least_above_zero(A: Array, b: Array) -> Array:
    """The u >= 0 of least |A u - b|; A: square, of full rank."""
    free = np.linalg.solve(A, b)
    if (free >= 0.0).all():
        return np.asarray(free)
    if len(free) == 1:
        return np.zeros(1)
    from scipy.optimize import nnls  # slow to load, and seldom needed

    return np.asarray(nnls(A, b)[0])


def _improved(
    model: LinearModel, ratios: Array, step: Array, current: MixedFit
) -> tuple[Array, MixedFit] | None:
    """The longest of the halved steps that lowers the criterion; None if only rounding is left."""
    length = 1.0
    for _ in range(_HALVINGS):
        trial = np.maximum(ratios + length * step, 0.0)
        trial_fit = fit(model, trial)
        if trial_fit is not None and trial_fit.criterion < current.criterion:
            return trial, trial_fit
        length /= 2
    return None


def _correlated(covariance: Array) -> NDArray[np.bool_]:
    """Which pairs of a covariance (c, c) are correlated too much to be separated."""
    sd = np.sqrt(np.diag(covariance))
    limit = ALIKE * np.outer(sd, sd)
    alike: NDArray[np.bool_] = (limit > 0.0) & (np.abs(covariance) > limit)
    return alike & ~np.eye(len(sd), dtype=bool)
