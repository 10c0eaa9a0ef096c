"""Variance components: the sds of sensors, learnt from the calibration itself.

Restricted maximum likelihood (Patterson and Thompson 1971) by Fisher scoring on the logarithms
of the variances, at the linearisation of the present fit; the calibration refits in between
until both settle. A component that the data want to be nothing ends at exactly zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.noise.linear_model import LinearModel, MixedFit, fit

Array = NDArray[np.float64]
_MOST = 200
_SEED = 1e-4
"""Where a component that the data want back begins again."""
_NOTHING = 0.5
"""A component that takes less than this of one degree of freedom is tried at zero."""
_OPEN = 1e-4
"""Information on the logarithm of a ratio, below which the data leave it open."""
_FEW, _MANY = 0.05, 1e6
"""Degrees of freedom outside which the rise to a bound is at its limit."""
_FARTHEST = 20.0
"""No bound is searched beyond so many powers of e above the estimate."""
ALIKE = 0.95
"""Two estimates correlated beyond this cannot be separated by the data."""


@dataclass(frozen=True)
class Component:
    """A set of quantities whose sds are known up to one common factor, which is estimated."""

    name: str
    quantities: tuple[int, ...]


@dataclass(frozen=True)
class Estimate:
    """Variance ratios (c,) to the present sds, with their covariance (c, c) and criterion.

    A ratio at zero has no variance here; see `upper_bound`.
    """

    ratios: Array
    covariance: Array
    criterion: float
    converged: bool

    def sd_of_root(self, which: int) -> float | None:
        """Sd of the root of a ratio, to first order; None at zero, or if data leave it open."""
        ratio, variance = float(self.ratios[which]), float(self.covariance[which, which])
        if ratio == 0.0 or variance > ratio * ratio / _OPEN:
            return None
        return 0.5 * math.sqrt(variance / ratio)


def estimate_ratios(
    model: LinearModel, start: Array | None = None, *, vanish: bool = True
) -> Estimate:
    """The variance ratios of greatest restricted likelihood, none negative.

    vanish: whether components may end at zero.
    """
    count = model.components
    ratios = np.ones(count) if start is None else np.array(start)
    free = ratios > 0.0
    current = fit(model, ratios)
    if current is None:
        ratios, free = np.ones(count), np.ones(count, dtype=bool)
        current = fit(model, ratios)
    if current is None:
        raise NoTrustworthyResult(
            "the sds cannot be learnt: where the fit ended, the loops have no usable noise model",
            remedy="calibrate with stated sds first, and see whether that converges",
        )
    gain = math.inf
    for _ in range(_MOST):
        vanished = _vanished(model, ratios, free, current) if vanish else None
        if vanished is not None:
            ratios[vanished], free[vanished] = 0.0, False
            current = _at(model, ratios)
        step = _scoring_step(current, ratios, free)
        if gain < 1e-9 or np.abs(step[free]).max(initial=0.0) < 1e-6:
            returning = ~free & (current.score > 1e-6 * current.contribution)
            if not returning.any() or gain == 0.0:
                return Estimate(ratios, _covariance(current, ratios, free), current.criterion, True)
            free |= returning
            ratios[returning] = _SEED
            current = _at(model, ratios)
            gain = math.inf
            continue
        moved = _improve(model, ratios, free, step, current)
        if moved is None:
            gain = 0.0
            continue
        ratios, following = moved
        gain = current.criterion - following.criterion
        current = following
    return Estimate(ratios, _covariance(current, ratios, free), current.criterion, False)


def _at(model: LinearModel, ratios: Array) -> MixedFit:
    found = fit(model, ratios)
    assert found is not None  # a component is only taken away where the loops close without it
    return found


def _scoring_step(current: MixedFit, ratios: Array, free: NDArray[np.bool_]) -> Array:
    """Fisher's step in the logarithms of the free ratios."""
    score = current.score * ratios
    information = current.information * np.outer(ratios, ratios)
    step = np.zeros_like(ratios)
    own = information[np.ix_(free, free)]
    if free.any():
        own = own + 1e-12 * np.trace(own) * np.eye(len(own))
        step[free] = np.linalg.solve(own, score[free])
    return np.clip(step, -2.0, 2.0)


def _improve(
    model: LinearModel, ratios: Array, free: NDArray[np.bool_], step: Array, current: MixedFit
) -> tuple[Array, MixedFit] | None:
    """The longest of the halved steps that does not raise the criterion."""
    length = 1.0
    for _ in range(12):
        trial = np.where(free, ratios * np.exp(length * step), 0.0)
        found = fit(model, trial)
        if found is not None and found.criterion <= current.criterion + 1e-10:
            return trial, found
        length /= 2
    return None


def _vanished(
    model: LinearModel, ratios: Array, free: NDArray[np.bool_], current: MixedFit
) -> int | None:
    """A component that is next to nothing and does no harm at zero."""
    if not free.any():
        return None
    share = np.where(free, ratios * current.contribution, np.inf)
    smallest = int(np.argmin(share))
    if share[smallest] > _NOTHING:
        return None
    without = ratios.copy()
    without[smallest] = 0.0
    zero = fit(model, without)
    gone = zero is not None and zero.criterion <= current.criterion + 1e-6
    return smallest if gone else None


def _covariance(current: MixedFit, ratios: Array, free: NDArray[np.bool_]) -> Array:
    covariance = np.zeros_like(current.information)
    index = np.flatnonzero(free)
    if index.size:
        scale = ratios[index]
        own = current.information[np.ix_(index, index)] * np.outer(scale, scale)
        values, vectors = np.linalg.eigh(own)
        # what only shows in a sum is left open by the data: almost no information on it
        values = np.maximum(values, _OPEN / 10.0)
        root = scale[:, None] * vectors / np.sqrt(values)
        covariance[np.ix_(index, index)] = root @ root.T
    return covariance


def without_component(model: LinearModel, estimate: Estimate, which: int) -> float | None:
    """The criterion with one component taken away and the others estimated again.

    None where the loops could not close without it.
    """
    smaller, start = _held(model, which, 0.0), np.delete(estimate.ratios, which)
    if fit(smaller, start) is None:
        return None
    return estimate_ratios(smaller, start).criterion


def _held(model: LinearModel, which: int, ratio: float) -> LinearModel:
    """The model with one component no longer estimated but taken as given at this ratio."""
    blocks = tuple(
        replace(b, fixed=b.fixed + ratio * b.parts[which], parts=np.delete(b.parts, which, axis=0))
        for b in model.blocks
    )
    return replace(model, blocks=blocks)


def upper_bound(
    model: LinearModel, estimate: Estimate, which: int, level: float = 0.95
) -> float | None:
    """The ratio up to which one component is compatible with the data; None if nothing bounds it.

    Where the criterion, least over all other components, has risen as far as `_rise` says. The
    others must give way: held where they are, they would leave no room for what is hidden in
    them. It is the upper end of a two-sided interval, because a bound is asked for only where the
    estimate came out low, which is half of all draws: so it holds in `level` of these.
    """
    from scipy.optimize import brentq

    present, others = float(estimate.ratios[which]), np.delete(estimate.ratios, which)
    beyond = 0.5 * (1.0 - level)

    def excess(logarithm: float) -> float:
        ratio = math.exp(logarithm)
        found = estimate_ratios(_held(model, which, ratio), others)
        information = _left(_at(model, np.insert(found.ratios, which, ratio)), found.ratios, which)
        needed = _rise(2.0 * ratio * ratio * information, beyond)
        return found.criterion - estimate.criterion - needed

    information = float(_at(model, estimate.ratios).information[which, which])
    if information <= 0.0:
        return None
    low = math.log(max(present, 1e-12))
    high = math.log(present + 1.0 / math.sqrt(information))
    farthest = high + _FARTHEST
    while excess(high) < 0.0:
        if high > farthest:
            return None
        low, high = high, high + 1.0
    return math.exp(float(brentq(excess, low, high, xtol=1e-4)))


def _left(at: MixedFit, others: Array, which: int) -> float:
    """The information on one ratio that estimating the others leaves."""
    free = np.insert(others > 0.0, which, False)
    own, cross = float(at.information[which, which]), at.information[which, free]
    shared = np.linalg.lstsq(at.information[np.ix_(free, free)], cross, rcond=1e-12)[0]
    return max(own - float(cross @ shared), 1e-9 * own)


def _rise(freedom: float, beyond: float) -> float:
    """By how much -2 log likelihood rises from a variance's estimate to its upper bound.

    Exact for a sum of squares of so many degrees of freedom: m (x - 1 - log x), where m x is the
    quantile of chi-squared with m degrees; the square of the normal quantile at many.
    """
    from scipy.special import chdtri, ndtri

    if freedom > _MANY:
        return float(ndtri(beyond)) ** 2
    freedom = max(freedom, _FEW)
    x = float(chdtri(freedom, 1.0 - beyond)) / freedom
    return freedom * (x - 1.0 - math.log(x))
