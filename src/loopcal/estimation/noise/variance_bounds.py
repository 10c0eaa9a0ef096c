"""What the likelihood says of one variance component while the others are estimated again.

The criterion along its profile needs no new information matrix at every step: Fisher's steps go by
one that was computed near, and by the exact score, at a third of the cost. It is computed anew
where a step keeps less than it promised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.linear_model import LinearModel, MixedFit, fit, slope, whitened
from loopcal.estimation.noise.variance_components import Estimate, scoring_step

Array = NDArray[np.float64]
# Caps against an endless search: chosen, not derived.
_MOST = 60
"""Steps of one profile, and of the search for a bound."""
_ENOUGH, _SHARE, _ROUGHLY = 1e-6, 1e-7, 1e-3
"""A profile ends where its next step promises less than this, or than this share of the rise; on
the way to a bound than the third, which leaves its logarithm right to some 1e-4."""
# docs/decisions/0020.
_KEPT = 0.5
"""Where a step brings less than this of what it promised, or more than its inverse, the information
matrix it came from does not serve any more."""
# A cap: 30 halvings leave 1e-9 of a step.
_HALVINGS = 30
# At 1e6 the rise is within 0.05 % of its limit, at 0.05 within 3 %.
_FEW, _MANY = 0.05, 1e6
"""Degrees of freedom outside which the rise to a bound is at its limit."""
_FARTHEST, _STRIDE = 20.0, 2.0
"""No bound is searched beyond so many powers of e above the estimate, in strides of at most so
many."""
_NEARLY = 2e-3
"""The search for the logarithm of a bound ends at a step of this; what is left is far less."""


@dataclass(frozen=True)
class _Place:
    """A point of the profile: the ratios there, and the criterion with its derivatives."""

    ratios: Array
    at: MixedFit


@dataclass
class _Profile:
    """The likelihood at given ratios of one component; it remembers the last place."""

    model: LinearModel
    estimate: Estimate
    which: int

    def __post_init__(self) -> None:
        self.last = _Place(self.estimate.ratios, self.estimate.at)
        self.free = np.arange(self.model.components) != self.which

    def at(self, ratio: float, *, informed: bool) -> _Place | None:
        """The place of greatest likelihood where the component has this ratio.

        informed: with the information near there, and roughly. None where the loops have no noise.
        """
        ratios = self.last.ratios.copy()
        ratios[self.which] = ratio
        place = self._measured(ratios, self.last.at.information)
        if place is None:
            return None
        lowest, right, fresh = np.zeros(len(ratios)), not informed, False
        for _ in range(_MOST):
            step = scoring_step(place.at, place.ratios, lowest, self.free)
            promised = _promised(place.at, step)
            rise = place.at.criterion - self.estimate.criterion
            ended = promised <= (_ROUGHLY if informed else max(_ENOUGH, _SHARE * rise))
            if not fresh and (not right or (ended and place.ratios is ratios)):
                fresh_fit = fit(self.model, place.ratios)
                if fresh_fit is None:
                    return None
                place, fresh, right = replace(place, at=fresh_fit), True, True
                continue
            if ended:
                break
            moved = self._lower(place, step)
            if moved is None:
                if fresh:
                    break
                right = False
                continue
            kept = (place.at.criterion - moved.at.criterion) / promised
            place, right, fresh = moved, 1.0 / _KEPT > kept > _KEPT, False
        self.last = place
        # The last step, which is not made, would gain this to second order.
        return replace(place, at=replace(place.at, criterion=place.at.criterion - promised))

    def _lower(self, place: _Place, step: Array) -> _Place | None:
        """The longest of the halved steps that lowers the criterion; None if none does."""
        length = 1.0
        for _ in range(_HALVINGS):
            ratios = np.maximum(place.ratios + length * step, 0.0)
            trial = self._measured(ratios, place.at.information)
            if trial is not None and trial.at.criterion < place.at.criterion:
                return trial
            length /= 2
        return None

    def _measured(self, ratios: Array, information: Array) -> _Place | None:
        joined = whitened(self.model, ratios)
        if joined is None:
            return None
        local_slope = slope(self.model, joined)
        return _Place(ratios, MixedFit(local_slope.criterion, local_slope.score, information))


def _promised(at: MixedFit, step: Array) -> float:
    return max(float(step @ (2.0 * at.score - at.information @ step)), 0.0)


def without_component(model: LinearModel, estimate: Estimate, which: int) -> float | None:
    """The criterion with one component taken away and the others estimated again.

    None where the loops could not close without it.
    """
    place = _Profile(model, estimate, which).at(0.0, informed=False)
    return None if place is None else place.at.criterion


def upper_bound(
    model: LinearModel, estimate: Estimate, which: int, level: float = 0.95
) -> float | None:
    """The ratio up to which one component is compatible with the data; None if nothing bounds it.

    Where the criterion, least over all other components, has risen as far as `_rise` says. The
    others must give way: held where they are, they would leave no room for what is hidden in
    them. It is the upper end of a two-sided interval: a bound is asked for only where the estimate
    came out low, which is half of all draws. So it holds in `level` of these.

    Found by Newton's steps in the logarithm, between what is below and what is above.
    """
    present = float(estimate.ratios[which])
    information = float(estimate.at.information[which, which])
    if information <= 0.0:
        return None
    beyond, profile = 0.5 * (1.0 - level), _Profile(model, estimate, which)
    low, high = math.log(max(present, 1e-12)), math.inf
    log_ratio = math.log(present + 1.0 / math.sqrt(information))
    farthest = log_ratio + _FARTHEST
    before: tuple[float, float] | None = None
    for _ in range(_MOST):
        ratio = math.exp(log_ratio)
        place = profile.at(ratio, informed=True)
        if place is None:
            return None
        # docs/decisions/0020: a variance from m squares has the information m / (2 ratio^2).
        needed = _rise(2.0 * ratio * ratio * _left(place, which), beyond)
        excess = place.at.criterion - estimate.criterion - needed
        # The criterion is -2 log L, and d ratio / d log ratio = ratio.
        rising = -2.0 * ratio * float(place.at.score[which])
        if before is not None and before[0] != log_ratio:
            # The rise that is needed changes along the way too, here by its last chord.
            rising -= (needed - before[1]) / (log_ratio - before[0])
        before = log_ratio, needed
        if excess < 0.0:
            low = log_ratio
        else:
            high = log_ratio
        step = -excess / rising if rising > 0.0 else math.inf
        if abs(step) <= _NEARLY:
            return math.exp(log_ratio + step)
        if math.isinf(high):
            if log_ratio > farthest:
                return None
            log_ratio += min(max(step, _NEARLY), _STRIDE)
        elif low < log_ratio + step < high:
            log_ratio += step
        else:
            log_ratio = 0.5 * (low + high)
        if high - low <= _NEARLY:
            return math.exp(log_ratio)
    return None


def _left(place: _Place, which: int) -> float:
    """The information on the held ratio that estimating the others leaves."""
    free = place.ratios > 0.0
    free[which] = False
    information = place.at.information
    diagonal, cross = float(information[which, which]), information[which, free]
    shared = np.linalg.lstsq(information[np.ix_(free, free)], cross, rcond=1e-12)[0]
    return max(diagonal - float(cross @ shared), 1e-9 * diagonal)


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
