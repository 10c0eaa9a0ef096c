"""Where a fit without some of its poses ends, from the fit of all.

The sums over all poses less those of the poses that are left out, both linearised where the fit of
all ended, give what is learnt of the rest and one Gauss-Newton step, exact where the loops are
linear. Each sweep over the rest gives another step and shows what one more would leave. Where few
of them do not end what can be seen, the rest has to be fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.merit import Evaluation
from loopcal.estimation.solve.reduction import Accumulator, Spectrum, spectrum
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.lazy import cached_property

if TYPE_CHECKING:
    from loopcal.estimation.noise.estimation import NoiseEstimate

Index = NDArray[np.intp]
# Chosen, not derived: far above the rounding of sums, far below a share that counts.
_LITTLE = 1e-9
"""Share of a parameter's information that rounding may leave where only the poses left out have
any: those of a station, of where it stands."""
_NEARBY = 0.3
"""A second step of the sensors' sds would change logarithms of variances by the square of what the
first one did: less than `loopcal.estimation.noise.estimation.NEARBY`, at which their search ends.
Those of terms have no step: the sums say them."""
# Chosen, not derived: so many sweeps cost less than half of a fit.
_STEPS = 4
"""Sweeps over the rest until it must be fitted."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where a fit of the rest begins, one step from the fit of all.

    parameters: (n_all,) [SI]; problem: the rest at its sds, those of terms as priors; factors: of
    each learnt component of the noise, its sd over the stated one; decrement: what the step was
    predicted to remove from chi-squared; near: whether the sds of sensors have changed by little.
    """

    parameters: Array
    problem: Problem
    factors: Mapping[str, float]
    decrement: float
    near: bool

    @property
    def values(self) -> Mapping[str, float]:
        """Of all parameters, by name [SI]."""
        names = self.problem.mechanism.parameters.names
        return dict(zip(names, self.parameters.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _SensorSums:
    """Over some poses, of the whitened equations E = D dp + v and W_j, the loadings of component j:
    products (c, n + 1, n + 1) of W_j^T [D E], squares (c,) = |W_j|^2."""

    products: Array
    squares: Array

    @classmethod
    def of(cls, whole: FitResult, index: Index | None = None) -> _SensorSums:
        """Of a fit, where it ended; index: of the poses at these positions."""
        from loopcal.estimation.noise.linear_model import columns, linear_model, whitened

        assert whole.estimate is not None
        began, stated, end = whole.estimate.began, whole.estimate.stated, whole.solution
        if index is None:
            index = np.arange(began.count)
        positions = [component.quantities for component in stated]
        corrections = end.corrections[:, index]
        model = linear_model(taken(began, index), end.parameters, corrections, positions)
        joined = whitened(model, whole.estimate.ratios)
        assert joined is not None  # the fit ended there
        n, c = len(model.precision) + 1, model.components
        products, squares = np.zeros((c, n, n)), np.zeros(c)
        for block, rows, W in zip(model.blocks, joined.rows, joined.W, strict=True):
            for j in range(c):
                part = W[:, :, columns(block.owner, j)]
                flat = (part.transpose(0, 2, 1) @ rows).reshape(-1, n)
                products[j] += flat.T @ flat
                squares[j] += np.square(part).sum()
            squares += block.spare_of(c) / np.maximum(whole.estimate.ratios, 1e-300)
        return cls(products, squares)

    def less(self, other: _SensorSums) -> _SensorSums:
        """Of all poses but the other ones."""
        return _SensorSums(self.products - other.products, self.squares - other.squares)

    def score(self, root: Array, dp: Array) -> Array:
        """(c,) derivatives of the restricted likelihood's logarithm by the variance ratios.

        root: H^-1 = root root^T; dp: (n,) the step (`loopcal.estimation.noise.linear_model`).
        """
        v, n = np.append(-dp, 1.0), len(dp)
        taken_up = [float(np.sum(root * (M[:n, :n] @ root))) for M in self.products]
        misfit = np.einsum("i,cij,j->c", v, self.products, v)
        return np.asarray(0.5 * (misfit - self.squares + np.array(taken_up)))


@dataclass(frozen=True, eq=False)
class LeavingOut:
    """The fit of all poses, from which those without some of them follow."""

    whole: FitResult

    @cached_property
    def sensors(self) -> _SensorSums | None:
        """Of components of the noise that the sums of the fit do not tell; None without any."""
        estimate = self.whole.estimate
        if estimate is None or not estimate.stated or estimate.variances.by_sums:
            return None
        return _SensorSums.of(self.whole)

    def begun(self, index: Index) -> Beginning | None:
        """Where the fit without the poses at these positions begins; None where the rest says
        nothing of a parameter."""
        whole, end = self.whole, self.whole.solution
        problem = whole.problem
        with one_blas_thread():
            try:
                gone = Sweeper(taken(problem, index)).sweep(
                    end.parameters, end.corrections[:, index]
                )
            except InputError:
                return None
            rest = Accumulator(len(problem.free), False, problem.units)
            # Sums of products can be subtracted; the digits that this loses do not matter: the
            # second step is from sums of the rest itself.
            rest.add_total(end.data.products - gone.data.total)
            left, all_ = (
                np.diag(sums)[: len(problem.free)] for sums in (rest.total, end.data.products)
            )
            if (left < _LITTLE * all_).any():
                return None
            at = self._learnt(rest, end.equations - gone.equations, index)
            unknowns, system = at.problem.unknowns, at.system
            after = unknowns.moved(end.parameters, system.step())
            if not np.isfinite(after).all():
                return None
            others = np.setdiff1d(np.arange(problem.count), index)
            names = [] if whole.estimate is None else [c.name for c in whole.estimate.stated]
            factors = dict(zip(names, np.sqrt(at.ratios).tolist(), strict=True))
            part = taken(at.problem, others)
            return Beginning(after, part, factors, system.decrement, at.change <= _NEARBY)

    def _learnt(self, rest: Accumulator, equations: int, index: Index) -> _Learnt:
        """What the sums over the rest say of the sds; those sums at these sds."""
        whole, end = self.whole, self.whole.solution
        problem, estimate = whole.problem, whole.estimate
        offset = problem.unknowns.offset(end.parameters)
        if estimate is None:
            system = spectrum(rest, offset, problem.unknowns.prior_sd)
            return _Learnt(problem, system, np.zeros(0), 0.0)
        from loopcal.estimation.noise.estimation import scaled
        from loopcal.estimation.noise.linear_model import MixedFit, stated_score
        from loopcal.estimation.noise.search import Bounds, scoring_step
        from loopcal.estimation.noise.term_scales import Sums
        from loopcal.estimation.noise.variances import (
            all_learnt,
            begun_with,
            learnt_terms,
            scales_of,
            with_scales,
        )

        positions = [component.quantities for component in estimate.stated]
        scales, ratios, change = scales_of(problem), estimate.ratios, 0.0
        if problem.mechanism.learnt_terms:
            sums = Sums(rest.total, False, equations)
            common = self.sensors is None and all_learnt(problem, positions)
            terms = learnt_terms(problem, sums, offset, common=common)
            scales = terms.scales
            if self.sensors is None:
                ratios = ratios * terms.at.factor
                # The sums are whitened at the fit's sds; larger noise weighs them less.
                rest.divide(terms.at.factor)
        system = spectrum(rest, offset, begun_with(problem, scales).unknowns.prior_sd)
        if self.sensors is not None:
            sensors = self.sensors.less(_SensorSums.of(whole, index))
            # That of all poses will do: it does not say where the score is zero.
            information = equations / end.equations * estimate.sensor_estimate.at.information
            score = sensors.score(system.root, system.step())
            spreads = np.array([component.spread for component in estimate.stated])
            score += stated_score(spreads, ratios)
            present = MixedFit(ratios, 0.0, score, information)
            bounds = Bounds(np.zeros(len(ratios)), np.ones(len(ratios), dtype=bool))
            stepped = ratios + scoring_step(present, bounds)
            kept = stepped > 0.0  # what vanishes has to be sought
            if (ratios[~kept] > 0.0).any():
                change = math.inf
            else:
                logs = np.abs(np.log(stepped[kept] / np.maximum(ratios[kept], 1e-300)))
                change = float(logs.max(initial=0.0))
            ratios = np.where(kept, stepped, ratios)
        stated = begun_with(estimate.began, scales)
        made = with_scales(scaled(stated, positions, ratios))
        return _Learnt(made, system, ratios, change)


@dataclass(frozen=True, eq=False)
class _Learnt:
    """problem: of all poses at the sds that the rest says; system: of the rest at these priors;
    ratios: (c,) of variances to stated ones; change: of their logarithms, at most."""

    problem: Problem
    system: Spectrum
    ratios: Array
    change: float


def settled(whole: FitResult, begun: Beginning, index: Index, tolerance: float) -> Array | None:
    """Parameters (n_all,) where the fit of the rest ends, some steps on; None where a further one
    would move any combination of them by more than so many of its sds, or what is learnt.

    index: positions of the poses that are left out.
    """
    problem, before = begun.problem, whole.solution.corrections
    if not begun.near:
        return None
    others = np.setdiff1d(np.arange(before.shape[1]), index)
    unknowns, n, sweeper = problem.unknowns, len(problem.free), Sweeper(problem)
    parameters, corrections, last = begun.parameters, before[:, others], begun.decrement
    with one_blas_thread():
        for step in range(_STEPS):
            try:
                at = sweeper.sweep(parameters, corrections, closing=NEAR)
            except InputError:
                return None
            if not at.finite or at.late or at.singular:
                return None
            system = spectrum(at.data, unknowns.offset(parameters), unknowns.prior_sd)
            if not system.well_conditioned and system.rank < n:
                return None  # an open direction would rest where all poses have put it
            # Convergence is linear, as in `loopcal.estimation.solve.solver`, which allows so many
            # sds in each of n directions. What the first step removed is what the poses left out
            # had said, which tells nothing of the rate: then all may lie in one direction.
            merit = at.cost + unknowns.prior_square(parameters)
            rate = min(system.decrement / max(last, 1e-300), 1.0)
            directions = n if step else 1
            enough = directions * tolerance**2 * merit / max(at.equations - n, 1)
            after = unknowns.moved(parameters, system.step())
            if rate * system.decrement <= enough:
                estimate = whole.estimate if problem.mechanism.learnt_terms else None
                stay = estimate is None or _terms_stay(estimate, begun, parameters, at)
                return after if stay else None
            if step and rate**2 * system.decrement > enough:
                return None
            parameters, corrections, last = after, at.proposal, system.decrement
    return None


def _terms_stay(
    estimate: NoiseEstimate, begun: Beginning, parameters: Array, at: Evaluation[Array]
) -> bool:
    """Whether the rest, linearised at these parameters, says the same of its terms as before."""
    from loopcal.estimation.noise.estimation import NEARBY
    from loopcal.estimation.noise.term_scales import Sums
    from loopcal.estimation.noise.variances import all_learnt, learnt_terms, scales_of

    problem, sums = begun.problem, Sums(at.data.total, False, at.equations)
    common = all_learnt(problem, [component.quantities for component in estimate.stated])
    offset = problem.unknowns.offset(parameters)
    scales = learnt_terms(problem, sums, offset, common=common).scales
    # As the last round of a fit that begins near.
    return 2.0 * float(np.abs(np.log(scales / scales_of(problem))).max(initial=0.0)) <= NEARBY
