"""Learning the sds of sensors while calibrating: fit and variance components in turn.

The fit at the present sds linearises the loops; restricted maximum likelihood on that model gives
new sds (`loopcal.estimation.variance_components`); both are repeated until neither moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.linear_model import LinearModel, linear_model
from loopcal.estimation.problem import Problem
from loopcal.estimation.solver import Solution
from loopcal.estimation.variance_components import (
    ALIKE,
    Component,
    Estimate,
    estimate_ratios,
    upper_bound,
    without_component,
)
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty

Array = NDArray[np.float64]
_MOST, _SETTLED = 60, 1e-4
_UNCERTAIN = 0.5
"""Relative sd of an sd from which on an upper bound says more than the estimate."""


@dataclass(frozen=True)
class EstimatedSd:
    """What the calibration says of one component's sd.

    name; quantities: positions; ratio: estimated over stated sd; sd_of_ratio: its sd, None at zero;
    upper_ratio: 95 % upper bound, where the estimate is zero or uncertain; likelihood_ratio:
    by how much -2 log of the restricted likelihood rises without the component, None where
    the loops could not close without it; p_value: of so large a rise if there were none of it.
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
    stated = problem
    positions = [component.quantities for component in components]
    ratios = np.ones(len(components))
    settled, before = False, math.inf
    for _ in range(_MOST):
        present = scaled(stated, positions, ratios)
        solution = fit(present)
        model = linear_model(
            replace(stated, start=solution.parameters),
            solution.parameters,
            solution.corrections,
            positions,
            at_readings=at_readings,
        )
        found = estimate_ratios(model, ratios)
        change = _change(ratios, found.ratios)
        ratios = found.ratios
        stated = replace(stated, start=solution.parameters)
        if change <= _SETTLED or abs(before - found.criterion) <= 1e-7:
            settled = found.converged
            break
        before = found.criterion
    present = scaled(stated, positions, ratios)
    solution = fit(present)
    return NoiseEstimate(
        present,
        solution,
        tuple(_judged(model, found, i, c) for i, c in enumerate(components)),
        found.criterion,
        _alike(found, components),
        settled,
    )


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


def _judged(model: LinearModel, found: Estimate, which: int, component: Component) -> EstimatedSd:
    from scipy.special import chdtrc

    variance_ratio = float(found.ratios[which])
    ratio = math.sqrt(variance_ratio)
    sd = None
    if variance_ratio > 0.0:
        sd = math.sqrt(max(float(found.covariance[which, which]), 0.0)) / (2.0 * ratio)
    upper = None
    if sd is None or sd > _UNCERTAIN * ratio:
        upper = math.sqrt(upper_bound(model, found, which))
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
