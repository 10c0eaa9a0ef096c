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
from loopcal.estimation.linear_model import LinearModel, MixedFit, fit

Array = NDArray[np.float64]
_MOST = 200
_SEED = 1e-4
"""Where a component that the data want back begins again."""
_NOTHING = 0.5
"""A component that takes less than this of one degree of freedom is tried at zero."""
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
                return Estimate(ratios, _covariance(current, free), current.criterion, True)
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
    return Estimate(ratios, _covariance(current, free), current.criterion, False)


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
    share = np.where(free, ratios * current.contribution, np.inf)
    smallest = int(np.argmin(share))
    if share[smallest] > _NOTHING:
        return None
    without = ratios.copy()
    without[smallest] = 0.0
    zero = fit(model, without)
    gone = zero is not None and zero.criterion <= current.criterion + 1e-6
    return smallest if gone else None


def _covariance(current: MixedFit, free: NDArray[np.bool_]) -> Array:
    covariance = np.zeros_like(current.information)
    index = np.flatnonzero(free)
    if index.size:
        own = current.information[np.ix_(index, index)]
        covariance[np.ix_(index, index)] = np.linalg.pinv(own, rcond=1e-12, hermitian=True)
    return covariance


def without_component(model: LinearModel, estimate: Estimate, which: int) -> float | None:
    """The criterion with one component taken away and the others estimated again.

    None where the loops could not close without it.
    """
    rest = [j for j in range(model.components) if j != which]
    smaller = _restricted(model, rest)
    start = estimate.ratios[rest]
    if fit(smaller, start) is None:
        return None
    return estimate_ratios(smaller, start).criterion


def _restricted(model: LinearModel, rest: list[int]) -> LinearModel:
    blocks = tuple(replace(b, parts=b.parts[rest]) for b in model.blocks)
    return replace(model, blocks=blocks)


def upper_bound(model: LinearModel, estimate: Estimate, which: int, level: float = 0.95) -> float:
    """The ratio up to which one component is compatible with the data, the others held.

    Where the criterion has risen by the chi-squared quantile with one degree of freedom that a
    one-sided bound of this level needs (2.71 for 95 %).
    """
    from scipy.optimize import brentq
    from scipy.special import ndtri

    rise = float(ndtri(level)) ** 2
    present = float(estimate.ratios[which])

    def excess(logarithm: float) -> float:
        ratios = estimate.ratios.copy()
        ratios[which] = math.exp(logarithm)
        found = fit(model, ratios)
        return math.inf if found is None else found.criterion - estimate.criterion - rise

    low = math.log(max(present, 1e-12))
    high = max(low, math.log(1e-6)) + 1.0
    while excess(high) < 0.0 and high < 60.0:
        high += 1.0
    return math.exp(float(brentq(excess, high - 1.0 if excess(high - 1.0) < 0 else low, high)))
