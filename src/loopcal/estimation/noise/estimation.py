"""Learning the sds of sensors while calibrating: fit and variance components in turn.

The fit at the present sds linearises the loops; restricted maximum likelihood on that model gives
new sds (`loopcal.estimation.noise.variance_components`); both are repeated until neither moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.linear_model import LinearModel, linear_model
from loopcal.estimation.noise.variance_components import (
    ALIKE,
    Component,
    Estimate,
    estimate_ratios,
    upper_bound,
    without_component,
)
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import Solution
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty

Array = NDArray[np.float64]
_MOST, _SETTLED, _BETTER = 60, 1e-5, 1e-6
"""Rounds; what logarithms of ratios still change by, and the criterion, where a search has ended:
near enough that searches which come to the same end do not seem better than each other."""
_FAR = 100.0
"""A variance so many times the stated one, or less than it by as much, is checked again."""
_ROUGHLY, _SLOWLY = 0.1, 100.0
"""Variance ratios that change less than this are roughly right; early ones fall no faster."""
_UNCERTAIN = 0.5
"""Relative sd of an sd from which on an upper bound says more than the estimate."""


@dataclass(frozen=True)
class EstimatedSd:
    """What the calibration says of one component's sd.

    name; quantities: positions; ratio: estimated over stated sd; sd_of_ratio: its sd, None at zero
    or where the data leave it open; upper_ratio: 95 % upper bound, where the estimate is zero,
    uncertain or hardly told apart from another (None also where nothing bounds it);
    likelihood_ratio: by how much -2 log of the restricted likelihood rises without the component,
    None where the loops could not close without it; p_value: of so large a rise if there were
    none of it.
    """

    name: str
    quantities: tuple[int, ...]
    ratio: float
    sd_of_ratio: float | None
    upper_ratio: float | None
    likelihood_ratio: float | None
    p_value: float | None


@dataclass(frozen=True)
class NoiseEstimate:
    """The fit at the estimated sds, and what was learnt of these.

    criterion: -2 log of the restricted likelihood, up to a constant of the readings; alike: pairs
    of components whose estimates are so correlated that these data cannot separate them.
    """

    problem: Problem
    solution: Solution
    components: tuple[EstimatedSd, ...]
    criterion: float
    alike: tuple[tuple[str, str], ...]
    settled: bool


def estimate_noise(
    problem: Problem,
    components: Sequence[Component],
    fit: Callable[[Problem], Solution],
    *,
    at_readings: bool = False,
) -> NoiseEstimate:
    """Fit and sds together, from the sds that the problem states.

    fit: the method; at_readings: whether it weighs the readings where they are (reweighted).
    """
    positions = [component.quantities for component in components]
    search = _Search(problem, positions, fit, at_readings)
    best = search.run(np.ones(len(components)))
    doubtful = list(search.doubtful(best))
    while doubtful:
        again = search.run(doubtful.pop(0))
        if again.found.criterion < best.found.criterion - _BETTER:
            best = again
            doubtful = list(search.doubtful(best))
    model, found = best.model, best.found
    alike = _alike(found, components)
    unsure = {name for pair in alike for name in pair}
    return NoiseEstimate(
        best.present,
        replace(best.solution, status=replace(best.solution.status, iterations=best.iterations)),
        tuple(_judged(model, found, i, c, c.name in unsure) for i, c in enumerate(components)),
        found.criterion,
        alike,
        best.settled,
    )


@dataclass(frozen=True)
class _Round:
    """Where a search ended: the problem at its sds, its fit, the model linearised there."""

    present: Problem
    solution: Solution
    model: LinearModel
    found: Estimate
    settled: bool
    iterations: int


@dataclass(frozen=True)
class _Search:
    stated: Problem
    positions: Sequence[Sequence[int]]
    fit: Callable[[Problem], Solution]
    at_readings: bool

    def doubtful(self, end: _Round) -> Iterator[Array]:
        """Other ratios to begin from, where the end is far from what was stated.

        At sds that are wrong by much the first fit may blame the wrong sensor and never get away
        from it: each sensor that ended far from its stated sd gets a second chance there.
        """
        for i, ratio in enumerate(end.found.ratios):
            if not 1.0 / _FAR < ratio < _FAR:
                other = end.found.ratios.copy()
                other[i] = 1.0
                yield other

    def run(self, ratios: Array) -> _Round:
        """Fit and ratios in turn, from these ratios."""
        start, before, vanish, iterations = self.stated.start, math.inf, False, 0
        for number in range(_MOST):
            present = replace(scaled(self.stated, self.positions, ratios), start=start)
            solution = self.fit(present)
            start, iterations = solution.parameters, iterations + solution.status.iterations
            model = linear_model(
                replace(self.stated, start=start),
                start,
                solution.corrections,
                self.positions,
                at_readings=self.at_readings,
            )
            found = estimate_ratios(model, ratios, vanish=vanish)
            change = _change(ratios, found.ratios)
            ended = change <= _SETTLED or abs(before - found.criterion) <= _BETTER
            if ended and vanish:
                return _Round(present, solution, model, found, found.converged, iterations)
            # No component may vanish before the others are roughly right.
            vanish = vanish or ended or change <= _ROUGHLY or number >= _MOST // 2
            lowest = 0.0 if vanish else ratios / _SLOWLY
            ratios = np.maximum(found.ratios, lowest)
            before = found.criterion
        return _Round(present, solution, model, found, False, iterations)


def scaled(problem: Problem, components: Sequence[Sequence[int]], ratios: Array) -> Problem:
    """The problem with the variances of some quantities multiplied by ratios."""
    factor = np.ones(len(problem.readings))
    for positions, ratio in zip(components, ratios, strict=True):
        factor[list(positions)] = math.sqrt(ratio)
    own = problem.uncertainty
    # inf times zero: what is not measured stays so
    sd = np.where(np.isinf(own.sd), own.sd, own.sd * factor[:, None])
    blocks = tuple(CovarianceBlock(b.indices, b.factor * factor[b.indices[0]]) for b in own.blocks)
    return replace(problem, uncertainty=ReadingUncertainty(sd, blocks, own.sources))


def _change(before: Array, after: Array) -> float:
    both = (before > 0.0) & (after > 0.0)
    if np.any((before > 0.0) != (after > 0.0)):
        return math.inf
    return float(np.abs(np.log(after[both] / before[both])).max(initial=0.0))


def _judged(
    model: LinearModel, found: Estimate, which: int, component: Component, unsure: bool
) -> EstimatedSd:
    from scipy.special import chdtrc

    ratio, sd = math.sqrt(float(found.ratios[which])), found.sd_of_root(which)
    upper = None
    if unsure or sd is None or sd > _UNCERTAIN * ratio:
        bound = upper_bound(model, found, which)
        upper = None if bound is None else math.sqrt(bound)
    without = None if len(found.ratios) == 1 else without_component(model, found, which)
    rise = None if without is None else max(without - found.criterion, 0.0)
    # at the boundary the rise is zero in half of all cases (Self and Liang 1987)
    p_value = None if rise is None else 0.5 * float(chdtrc(1, rise)) if rise > 0.0 else 1.0
    return EstimatedSd(component.name, component.quantities, ratio, sd, upper, rise, p_value)


def _alike(found: Estimate, components: Sequence[Component]) -> tuple[tuple[str, str], ...]:
    spread = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    pairs = []
    for i in range(len(components)):
        for j in range(i):
            scale = spread[i] * spread[j]
            if scale > 0.0 and abs(found.covariance[i, j]) > ALIKE * scale:
                pairs.append((components[j].name, components[i].name))
    return tuple(pairs)
