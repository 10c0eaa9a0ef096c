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

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import LinearModel, mixed_fit, whitened
from loopcal.estimation.noise.search import Bounds, scoring_step
from loopcal.estimation.noise.term_scales import Sums, TermVariances, learn_scales, term_system
from loopcal.estimation.noise.variance_components import Estimate, estimate_ratios, no_noise
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import End

# Chosen, not derived: farther, the linearisation is not to be believed.
_FARTHEST = 100.0
"""No variance grows more in one step."""


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


def learnt_terms(problem: Problem, sums: Sums, offset: Array, *, common: bool) -> TermVariances:
    """What the sums of some poses say of a problem's terms, and of all noise if that is learnt.

    offset: (n,) nominal - present value, where the loops were linearised.
    """
    terms = problem.mechanism.learnt_terms
    system = term_system(sums, problem.prior_sd, offset, owners(problem), terms)
    return learn_scales(system, scales_of(problem), common=common)


def by_common_factor(problem: Problem, end: End[Any], ratio: float | None) -> Variances:
    """The scales of the terms, and the factor common to all noise unless it is as stated.

    problem: at the sds of the fit; ratio: of these to the stated variances, None: not learnt.
    """
    sums = Sums(end.data.total, end.data.triangular, end.equations)
    offset = problem.unknowns.offset(end.parameters)
    learnt = learnt_terms(problem, sums, offset, common=ratio is not None)
    if ratio is None:
        return Variances(np.zeros(0), learnt.at.criterion, True, learnt)
    # The sums are whitened at the present sds, so log|V| lacks log ratio for each equation.
    criterion = learnt.at.criterion + end.equations * float(np.log(ratio))
    return Variances(np.array([ratio * learnt.at.factor]), criterion, True, learnt)


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
    ratios are the best ones at once. The scales are not learnt beside a factor of all noise: of few
    poses they would explain everything without noise, which the ratios then contradict, and the
    turns never end. Their sds allow for it.

    Raises NoTrustworthyResult where the loops have no noise.
    """
    if not problem.mechanism.learnt_terms:
        estimate = estimate_ratios(linear, ratios, lowest=lowest)
        return Variances(estimate.ratios, estimate.criterion, estimate.converged, None, estimate)
    summed = end is not None and not end.data.triangular
    joined = whitened(linear, ratios, end.data.total if end and summed else None)
    if joined is None:
        raise no_noise()
    sums = Sums(joined.total, False, sum(block.e.size for block in linear.blocks))
    learnt = learnt_terms(problem, sums, linear.offset, common=False)
    if common:
        learnt = replace(learnt, free=np.ones_like(learnt.free))
    prior_sd = begun_with(problem, learnt.scales).prior_sd
    linear = replace(linear, precision=1.0 / np.square(prior_sd))
    if (ratios <= lowest).all():
        present = mixed_fit(linear, joined, np.zeros((len(ratios), len(ratios))))
        if (present.score <= 0.0).all():  # no information lets them rise
            criterion = present.criterion + learnt.prior_criterion
            return Variances(ratios, criterion, True, learnt, resting=True)
    present = mixed_fit(linear, joined)
    step = scoring_step(present, Bounds(lowest, np.ones(len(ratios), dtype=bool)))
    # No multiple leads away from a ratio of 0: it may rise to the stated variance.
    stepped = np.clip(ratios + step, lowest, _FARTHEST * ratios + (ratios == 0.0))
    criterion = present.criterion + learnt.prior_criterion
    return Variances(stepped, criterion, True, learnt, Estimate(present))


def all_learnt(problem: Problem, components: Sequence[Sequence[int]]) -> bool:
    """Whether every sensor with noise is in one of the components."""
    sd = problem.uncertainty.sd
    noisy = np.flatnonzero((np.isfinite(sd) & (sd > 0.0)).any(axis=1))
    return set(noisy.tolist()) <= {i for positions in components for i in positions}
