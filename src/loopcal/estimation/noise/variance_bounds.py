"""What the likelihood says of one variance component while the others are estimated again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import LinearModel, MixedFit, fit
from loopcal.estimation.noise.search import Bounds, scoring_step, search
from loopcal.estimation.noise.variance_components import Estimate

# A cap against an endless search: chosen, not derived.
_MOST = 60
"""Steps of the search for a bound."""
_ENOUGH, _ROUGHLY = 1e-6, 0.03
"""A profile ends where its next step promises less than this, at a bound than the second: the
promise counts as kept, and what it is wrong by moves the logarithm of a bound by some 1e-4."""
_FIRST, _SHARE = 0.5, 0.1
"""The same on the way to a bound: at first, then this share of how far the rise is off."""
# At 1e6 the rise is within 0.05 % of its limit, at 0.05 within 3 %.
_FEW, _MANY = 0.05, 1e6
"""Degrees of freedom outside which the rise to a bound is at its limit."""
_FARTHEST, _STRIDE = 20.0, 2.0
"""No bound is searched beyond so many powers of e above the estimate, in strides of at most so
many."""
_NEARLY = 2e-3
"""The search for the logarithm of a bound ends at a step of this; what is left is far less."""


@dataclass
class _Profile:
    """The likelihood at given ratios of one component; it remembers the last place."""

    model: LinearModel
    estimate: Estimate
    which: int

    def __post_init__(self) -> None:
        self.last = self.estimate.at
        c = self.model.components
        self.bounds = Bounds(np.zeros(c), np.arange(c) != self.which)

    def at(self, ratio: float, enough: float, *, informed: bool = True) -> MixedFit | None:
        """The place of greatest likelihood where the component has this ratio.

        enough: the search ends where a step promises the criterion no more; informed: whether the
        information there is asked for. None where the loops have no noise.
        """
        place = fit(self.model, self._foreseen(ratio))
        if place is None:
            return None
        likelihood = partial(fit, self.model)
        end = search(likelihood, place, self.bounds, enough=enough, correcting=not informed)
        self.last = end.at
        # The last step, which is not made, would gain what it promises to second order, and
        # change the score as the information says.
        score = end.at.score - end.at.information @ end.step
        return replace(end.at, criterion=end.at.criterion - end.promised, score=score)

    def _foreseen(self, ratio: float) -> Array:
        """The ratios where this one has moved, and the others give way as the information says."""
        moved = np.zeros(len(self.last.x))
        moved[self.which] = ratio - self.last.x[self.which]
        asked = replace(self.last, score=self.last.score - self.last.information @ moved)
        return np.asarray(self.last.x + moved + scoring_step(asked, self.bounds))


def without_component(model: LinearModel, estimate: Estimate, which: int) -> float | None:
    """The criterion with one component taken away and the others estimated again.

    None where the loops could not close without it.
    """
    place = _Profile(model, estimate, which).at(0.0, _ENOUGH, informed=False)
    return None if place is None else place.criterion


def upper_bound(
    model: LinearModel, estimate: Estimate, which: int, level: float = 0.95
) -> float | None:
    """The ratio up to which one component is compatible with the data; None if nothing bounds it.

    Where the criterion, least over all other components, has risen as far as `_rise` says. The
    others must give way: held where they are, they would leave no room for what is hidden in
    them. It is the upper end of a two-sided interval: a bound is asked for only where the estimate
    came out low, which is half of all draws. So it holds in `level` of these.

    Found by Newton's steps of the root of the rise by the logarithm, which is nearly straight,
    between what is below and what is above.
    """
    present = float(estimate.ratios[which])
    information = float(estimate.at.information[which, which])
    if information <= 0.0:
        return None
    beyond, profile = 0.5 * (1.0 - level), _Profile(model, estimate, which)
    low, high = math.log(max(present, 1e-12)), math.inf
    near = math.log(present + 1.0 / math.sqrt(information))
    by_information = math.sqrt(_rise(math.inf, beyond) / _left(estimate.at, which))
    log_ratio = min(math.log(present + by_information), near + _STRIDE)
    farthest, enough = near + _FARTHEST, _FIRST
    before: tuple[float, float] | None = None
    for _ in range(_MOST):
        ratio = math.exp(log_ratio)
        place = profile.at(ratio, enough)
        if place is None:
            return None
        # docs/decisions/0020: a variance from m squares has the information m / (2 ratio^2).
        needed = _rise(2.0 * ratio * ratio * _left(place, which), beyond)
        rise = place.criterion - estimate.criterion
        # The criterion is -2 log L, and d ratio / d log ratio = ratio.
        rising = -2.0 * ratio * float(place.score[which])
        if before is not None and before[0] != log_ratio:
            # The rise that is needed changes along the way too, here by its last chord.
            rising -= rise / needed * (needed - before[1]) / (log_ratio - before[0])
        before = log_ratio, needed
        if rise < needed:
            low = log_ratio
        else:
            high = log_ratio
        step = math.inf
        if rise > 0.0 and rising > 0.0:
            step = 2.0 * (math.sqrt(rise * needed) - rise) / rising
        if abs(step) <= _NEARLY and enough <= _ROUGHLY:
            return math.exp(log_ratio + step)
        enough = max(_SHARE * abs(rise - needed), _ROUGHLY)
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


def _left(place: MixedFit, which: int) -> float:
    """The information on the held ratio that estimating the others leaves."""
    free = place.x > 0.0
    free[which] = False
    information = place.information
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
