"""Variance components: the sds of sensors, learnt from the calibration itself.

Restricted maximum likelihood (Patterson and Thompson 1971) by Fisher scoring on the variance
ratios, at one linearisation of the loops; the calibration refits in between until both settle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.noise.linear_model import LinearModel, MixedFit, fit, linear_model
from loopcal.estimation.noise.search import Bounds, search
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import Solution
from loopcal.lazy import cached_property
from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.model_error import disturbances, with_model_error

_AT_BOUND = 1e-9
"""A step that leaves no more than this of a ratio above its bound leads to the bound."""
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
    """A set of quantities whose sds are known up to one common factor, which is estimated.

    spread: sd of the logarithm of this factor, as far as it is known beforehand; inf: not at all.
    """

    name: str
    quantities: tuple[int, ...]
    spread: float = math.inf


@dataclass(frozen=True)
class Estimate:
    """Variance ratios to the stated sds, and the likelihood there."""

    at: MixedFit
    converged: bool = True

    @property
    def ratios(self) -> Array:
        """(c,)."""
        return self.at.x

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
        chance = (pull < _NO_PULL) & (not self.at.parted)
        flat: NDArray[np.bool_] = (self.ratios == 0.0) & chance
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
    stated = np.ones(model.components)
    bounds = Bounds(0.0 * stated if lowest is None else lowest, stated > 0.0)
    begun = fit(model, stated if start is None else np.array(start)) or fit(model, stated)
    if begun is None:
        raise no_noise()
    end = search(partial(fit, model), begun, bounds)
    if not end.converged:
        return Estimate(end.at, False)
    # what goes to its bound is there, however little is left to gain by it
    ratios = end.at.x
    vanishes = ratios + end.step <= bounds.lowest + _AT_BOUND * ratios
    ended = np.where(vanishes, bounds.lowest, ratios)
    final = end.at.fresh and np.array_equal(ended, ratios)
    return Estimate(end.at if final else fit(model, ended) or end.at)


def no_noise() -> NoTrustworthyResult:
    """What to report of loops in which no reading has noise where a fit ended."""
    return NoTrustworthyResult(
        "the sds cannot be estimated: the loops have no usable noise model where the fit ended",
        remedy="calibrate with stated sds first and check that the fit converges",
    )


def _correlated(covariance: Array) -> NDArray[np.bool_]:
    """Which pairs of a covariance (c, c) are correlated too much to be separated."""
    sd = np.sqrt(np.diag(covariance))
    limit = ALIKE * np.outer(sd, sd)
    alike: NDArray[np.bool_] = (limit > 0.0) & (np.abs(covariance) > limit)
    return alike & ~np.eye(len(sd), dtype=bool)


# How large an error of the machine model would explain what the sensors do not.

# Chosen, not derived: time and memory of whitening all poses, for a single number.
_MOST_POSES = 20_000
# Any value serves, because its ratio is estimated; 0.1 mm keeps this ratio near 1.
_START = 1e-4


def model_discrepancy(problem: Problem, solution: Solution) -> float | None:
    """The sd [unit of the outputs] of an isotropic error at the end point, beside the sensors.

    Restricted maximum likelihood of one further variance component at the loops as linearised by
    the fit. The fit is not repeated: it is an indication, where chi-squared is too large. None
    where the mechanism has no outputs or such an error already, or for more poses than are worth
    it.
    """
    mechanism = problem.mechanism
    names = disturbances(mechanism)
    units = {mechanism.quantities[q] for q in mechanism.outputs}
    if len(units) != 1 or mechanism.disturbances or len(problem.poses) > _MOST_POSES:
        return None
    rows = np.zeros((len(names), len(problem.poses)))
    uncertainty = problem.uncertainty
    # A unit only: what is learnt is the ratio to it.
    sd = np.vstack([uncertainty.sd, np.full((len(names), uncertainty.sd.shape[1]), _START)])
    disturbed = replace(
        problem.where_closed,
        mechanism=with_model_error(mechanism),
        readings=np.vstack([problem.readings, rows]),
        uncertainty=ReadingUncertainty(
            sd, uncertainty.blocks, (*uncertainty.sources, *("given",) * len(names))
        ),
    )
    positions = range(len(problem.readings), len(problem.readings) + len(names))
    corrections = np.vstack([solution.corrections, rows])
    model = linear_model(disturbed, solution.parameters, corrections, [list(positions)])
    return _START * math.sqrt(float(estimate_ratios(model).ratios[0]))
