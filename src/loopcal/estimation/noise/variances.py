"""All variances that are learnt at one linearisation: those of sensors, and those of terms.

Where one factor is common to all noise, the sums over all poses of the fit itself say everything,
whatever the number of poses. Else the scales of the terms (`term_scales`, by sums) and one step of
the sensors' ratios (`variance_components`, by pose) take turns; the next fit goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.noise.linear_model import (
    LinearModel,
    mixed_fit,
    slope,
    whitened,
)
from loopcal.estimation.noise.term_scales import (
    Sums,
    TermFit,
    TermSystem,
    begun,
    learn_scales,
    term_system,
)
from loopcal.estimation.noise.variance_components import (
    Estimate,
    estimate_ratios,
    scoring_step,
)
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import End

Array = NDArray[np.float64]
# Chosen, not derived: farther, the linearisation is not to be believed.
_FARTHEST = 100.0
"""No variance grows more in one step."""


@dataclass(frozen=True)
class TermVariances:
    """The terms at one linearisation: the sums that say it, and where the criterion is least.

    free: which of the criterion's arguments were learnt.
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


@dataclass(frozen=True)
class Variances:
    """What one linearisation says.

    ratios: (c,) of the sensor components to the stated variances; terms: None without any;
    sensors: how the ratios were found, None where one is common to all noise, or they rest;
    resting: whether all are at their bounds, where their score alone holds them; criterion: -2 log
    of the restricted likelihood, up to a constant.
    """

    ratios: Array
    criterion: float
    converged: bool
    terms: TermVariances | None = None
    sensors: Estimate | None = None
    resting: bool = False

    @property
    def by_sums(self) -> bool:
        """Whether the sums over all poses said everything."""
        return self.terms is not None and self.sensors is None and not self.resting


def owners(problem: Problem) -> NDArray[np.intp]:
    """(n,) which learnt term each estimated parameter is in, -1 if none."""
    terms = problem.mechanism.learnt_terms
    by_name = {n: i for i, term in enumerate(terms) for n in term.parameters}
    return np.array([by_name.get(name, -1) for name in problem.names], dtype=np.intp)


def scales_of(problem: Problem) -> Array:
    """The present sd of each learnt term [SI], which all its parameters share."""
    _, first = np.unique(owner := owners(problem), return_index=True)
    return problem.prior_sd[first[owner[first] >= 0]]


def begun_with(problem: Problem, scales: Array) -> Problem:
    """The problem with these sds of its terms."""
    owner = owners(problem)
    if not len(scales):
        return problem
    return replace(problem, prior_sd=np.where(owner >= 0, scales[owner], problem.prior_sd))


def with_scales(problem: Problem) -> Problem:
    """The problem with the sds of its terms in its mechanism too."""
    if not problem.mechanism.learnt_terms:
        return problem
    machine = problem.mechanism
    stated = dict(zip(problem.names, problem.prior_sd.tolist(), strict=True))
    made = machine.with_parameters(machine.parameters.with_prior(stated))
    return replace(problem, mechanism=made)


def system_of(problem: Problem, sums: Sums, parameters: Array) -> TermSystem:
    """The system of a problem's terms where a fit has ended."""
    offset = problem.unknowns.offset(parameters)
    terms = problem.mechanism.learnt_terms
    return term_system(sums, problem.prior_sd, offset, owners(problem), terms)


def sums_of(end: End[Any]) -> Sums:
    """The sums of a fit, whitened with the sds that it used."""
    return Sums(end.data.total, end.data.triangular, end.equations)


def by_common_factor(problem: Problem, end: End[Any], ratio: float | None) -> Variances:
    """The scales of the terms, and the factor common to all noise unless it is as stated.

    problem: at the sds of the fit; ratio: of these to the stated variances, None: not learnt.
    """
    system, common = system_of(problem, sums_of(end), end.parameters), ratio is not None
    start = begun(scales_of(problem), common=common)
    at = learn_scales(system, start)
    learnt = TermVariances(system, at, start.free)
    if ratio is None:
        return Variances(np.zeros(0), at.criterion, True, learnt)
    # The sums are whitened at the present sds, so log|V| lacks log ratio for each equation.
    volume = end.equations * float(np.log(ratio))
    return Variances(np.array([ratio * at.factor]), at.criterion + volume, True, learnt)


@dataclass(frozen=True)
class Learnt:
    """The problem at the sds of its terms, and the factor common to all noise."""

    problem: Problem
    factor: float


def learnt_by_sums(
    problem: Problem, sums: Sums, parameters: Array, components: Sequence[Sequence[int]]
) -> Learnt:
    """What the sums of some poses say of the terms, and of all noise where it is learnt.

    parameters: (n_all,) where the loops were linearised.
    """
    start = begun(scales_of(problem), common=all_learnt(problem, components))
    at = learn_scales(system_of(problem, sums, parameters), start)
    return Learnt(begun_with(problem, at.scales), at.factor)


def in_turn(
    problem: Problem,
    linear: LinearModel,
    ratios: Array,
    lowest: Array,
    *,
    common: bool,
    end: End[Any] | None = None,
) -> Variances:
    """The scales of the terms at the sensors' present ratios, then one step of the ratios.

    problem: at the scales of the fit; linear: where the fit ended; ratios: (c,) present ones,
    lowest: (c,) what none falls below; common: whether all noise is learnt; end: of the fit, whose
    sums over all poses serve where it linearised the loops at the same place. Without terms the
    ratios are the best ones at once. Raises NoTrustworthyResult where the loops have no noise.
    """
    if not problem.mechanism.learnt_terms:
        estimate = estimate_ratios(linear, ratios, lowest=lowest)
        return Variances(estimate.ratios, estimate.criterion, estimate.converged, None, estimate)
    summed = end is not None and not end.data.triangular
    joined = whitened(linear, ratios, end.data.total if end and summed else None)
    if joined is None:
        raise NoTrustworthyResult(
            "the sds cannot be estimated: the loops have no usable noise model where the fit ended",
            remedy="calibrate with stated sds first and check that the fit converges",
        )
    owner, terms = owners(problem), problem.mechanism.learnt_terms
    sums = Sums(joined.total, False, sum(block.e.size for block in linear.blocks))
    system = term_system(sums, problem.prior_sd, linear.offset, owner, terms)
    start = begun(scales_of(problem), common=common)
    at = learn_scales(system, start)
    learnt = TermVariances(system, at, start.free)
    prior_sd = np.where(owner >= 0, at.scales[owner], problem.prior_sd)
    linear = replace(linear, precision=1.0 / np.square(prior_sd))
    if (ratios <= lowest).all():
        local_slope = slope(linear, joined)
        if (local_slope.score <= 0.0).all():  # no information lets them rise
            criterion = local_slope.criterion + learnt.prior_criterion
            return Variances(ratios, criterion, True, learnt, resting=True)
    present = mixed_fit(linear, joined)
    step = scoring_step(present, ratios, lowest, np.ones(len(ratios), dtype=bool))
    # No multiple leads away from a ratio of 0: it may rise to the stated variance.
    stepped = np.clip(ratios + step, lowest, _FARTHEST * ratios + (ratios == 0.0))
    criterion = present.criterion + learnt.prior_criterion
    return Variances(stepped, criterion, True, learnt, Estimate(ratios, present, True))


def all_learnt(problem: Problem, components: Sequence[Sequence[int]]) -> bool:
    """Whether every sensor with noise is in one of the components."""
    sd = problem.uncertainty.sd
    noisy = np.flatnonzero((np.isfinite(sd) & (sd > 0.0)).any(axis=1))
    return set(noisy.tolist()) <= {i for positions in components for i in positions}
