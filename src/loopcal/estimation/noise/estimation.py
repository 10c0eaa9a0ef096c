"""Learning the sds of sensors while calibrating: fit and variance components in turn.

The fit at the present sds linearises the loops; restricted maximum likelihood on that model gives
new sds (`loopcal.estimation.noise.variance_components`); both are repeated until neither moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import LinearModel, linear_model
from loopcal.estimation.noise.linear_model import fit as fit_at
from loopcal.estimation.noise.prints import Prints
from loopcal.estimation.noise.variance_bounds import upper_bound, without_component
from loopcal.estimation.noise.variance_components import (
    Component,
    Estimate,
)
from loopcal.estimation.noise.variances import (
    Variances,
    all_learnt,
    begun_with,
    by_common_factor,
    in_turn,
    scales_of,
    with_scales,
)
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.execution.executor import gathered
from loopcal.execution.forked import process_cores
from loopcal.lazy import cached_property
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty
from loopcal.mechanisms.mechanism import PIXELS


class Fitting(Protocol):
    """A fit of a problem."""

    def __call__(self, problem: Problem, /, *, tolerance: float | None = ...) -> Solution:
        """tolerance: the step [sds] that counts as converged, None is the method's own."""


# docs/decisions/0020 for the second: it concerns the logarithms.
_MOST, _SETTLED, _BETTER = 60, 1e-5, 1e-6
"""Rounds; what logarithms of ratios still change by, and the criterion, where a search has ended:
near enough that searches which come to the same end do not seem better than each other."""
# An sd tenfold off, either way. Chosen, not derived: the linearisation may have misled.
_FAR = 100.0
"""A variance so many times the stated one, or less than it by as much, is checked again."""
# Chosen, not derived: an early linearisation may call a variance zero that is not.
_ROUGHLY, _SLOWLY = 0.1, 100.0
"""Variance ratios that change less than this are roughly right; early ones fall no faster."""
# Chosen, not derived: no instrument is ten thousand times better than its data sheet.
_LEAST = 1e-8
"""No variance that stays above zero falls below this share of the stated one. Of a coordinate that
reads the same in all poses the likelihood has no other bound."""
NEAR, NEARBY, ROUGH = 1e-3, 1e-1, 1e-2
"""With terms, logarithms of variances still change by so much in the last round, far less than
their uncertainty, the second where the search begins at those of nearly the same readings or has
gone on for half of all rounds; the first fit ends so many sds near the optimum, the third."""
PRINTED = 1e-2
"""Offsets of points that change by so many sds have settled."""
# Chosen, not derived: looser fits cost rounds, tighter ones steps.
_SHARE = 0.1
"""A rough fit ends so many sds near its optimum for each unit by which the logarithms change."""
# Chosen on sets of eight kinds: with 1, 2, 3 and 5 turns and cuts of 0.03 and 0.1 they took 740 to
# 790 rounds.
_MIXED, _CUT = 3, 0.1
"""A step is mixed with the changes of so many turns before. Singular values of these changes below
that share of the largest are left out: rough fits hide them."""
# Chosen, not derived: new sds may mend one failure; every further one costs a fit.
_FAILURES = 1
"""So many fits in succession may end without converging."""
# Residuals of 300 sds: chosen, not derived, beyond any sds that are only wrong.
_HOPELESS = 1e5
"""An unconverged fit with whitened residuals this large (mean square) ends the search."""
# Chosen, not derived: an interval of two such sds reaches zero.
_UNCERTAIN = 0.5
"""Relative sd of an sd from which on an upper bound says more than the estimate."""

# Chosen, not derived: some 10 ms, which is what a copy of a process costs.
_LONG = 10_000_000
"""Products of one evaluation of the likelihood from which on components are judged side by side."""


@dataclass(frozen=True)
class EstimatedSd:
    """What the calibration says of one component's sd.

    name; quantities: positions; ratio: estimated over stated sd; sd_of_ratio: its sd, None at zero
    or where the data leave it open; upper_ratio: 95 % upper bound, where the estimate is zero,
    uncertain or hardly told apart from another (None also where nothing bounds it);
    likelihood_ratio: by how much -2 log of the restricted likelihood rises without the component,
    None where the loops could not close without it, or the fit did not converge; p_value: of so
    large a rise if there were none of it.
    """

    name: str
    quantities: tuple[int, ...]
    ratio: float
    sd_of_ratio: float | None = None
    upper_ratio: float | None = None
    likelihood_ratio: float | None = None
    p_value: float | None = None


@dataclass(frozen=True)
class NoiseEstimate:
    """The fit at the estimated sds, and what was learnt of these.

    problem: at these sds, those of its terms included; began: at the stated ones; variances: what
    the last linearisation says.
    """

    problem: Problem
    solution: Solution
    stated: tuple[Component, ...]
    began: Problem
    variances: Variances
    settled: bool
    prints: Prints | None = None

    @cached_property
    def model(self) -> LinearModel:
        """The loops linearised at this fit."""
        positions = [component.quantities for component in self.stated]
        model = linear_model(
            replace(self.began, prior_sd=self.problem.prior_sd),
            self.solution.parameters,
            self.solution.corrections,
            positions,
            [component.spread for component in self.stated],
        )
        return _spent(model, self.prints, self.began, positions)

    @property
    def ratios(self) -> Array:
        """(c,) of the sensor components, where one is not common to all noise: at these the loops
        were whitened last."""
        sensors = self.variances.sensors
        return self.variances.ratios if sensors is None else sensors.ratios

    @cached_property
    def sensor_estimate(self) -> Estimate:
        """The same with their likelihood and what is known of them."""
        assert not self.variances.by_sums
        if self.variances.sensors is not None:
            return self.variances.sensors
        at = fit_at(self.model, self.ratios)
        assert at is not None  # they were found there
        return Estimate(at)

    @cached_property
    def criterion(self) -> float:
        """-2 log of the restricted likelihood at this fit's own linearisation.

        Up to a constant of the readings; not to be compared with that of another fit, whose loops
        are linearised elsewhere.
        """
        if self.variances.terms is None:
            return self.sensor_estimate.criterion
        at = fit_at(self.model, self.variances.ratios)
        assert at is not None
        return at.criterion + self.variances.terms.prior_criterion

    @property
    def factors(self) -> Mapping[str, float]:
        """Estimated over stated sd of each component, by name."""
        ratios = zip(self.stated, self.variances.ratios, strict=True)
        return {component.name: math.sqrt(ratio) for component, ratio in ratios}

    @cached_property
    def alike(self) -> tuple[tuple[str, str], ...]:
        """Pairs of components that these data cannot separate: only their sum shows."""
        if self.variances.by_sums:
            return ()
        names = [component.name for component in self.stated]
        return tuple((names[j], names[i]) for j, i in self.sensor_estimate.alike)

    @cached_property
    def components(self) -> tuple[EstimatedSd, ...]:
        """What the calibration says of each component; computed on request, it costs most.

        Without statistics where the fit did not converge.
        """
        plain = tuple(EstimatedSd(c.name, c.quantities, self.factors[c.name]) for c in self.stated)
        if not self.solution.status.converged:
            return plain
        if self.variances.by_sums and self.variances.terms is not None:
            sd = 0.5 * float(self.variances.terms.sds[0])  # of the factor common to all noise
            return tuple(replace(one, sd_of_ratio=one.ratio * sd) for one in plain)
        import scipy.special  # noqa: F401  ahead of the copies, each of which would load it

        unsure = {name for pair in self.alike for name in pair}
        model, at = self.model, self.sensor_estimate

        def said(_: None, which: int) -> EstimatedSd:
            component = self.stated[which]
            return judged(model, at, which, component, component.name in unsure)

        cores = process_cores() if model.products >= _LONG else None
        with one_blas_thread():
            return tuple(gathered(cores, said, None, range(len(self.stated))))

    def gain(self, which: int) -> float | None:
        """By how much one component lowers -2 log of the likelihood; None where that is not known.

        Beside what `components` says of it, its bounds with it, this costs little.
        """
        if self.variances.by_sums or not self.solution.status.converged:
            return None
        return gain_of(self.model, self.sensor_estimate, which)


def estimate_noise(
    problem: Problem,
    components: Sequence[Component],
    fit: Fitting,
    *,
    begin: Mapping[str, float] | None = None,
    roughly: bool = False,
) -> NoiseEstimate:
    """Fit and sds together: those of sensors, and those of the terms of the mechanism.

    fit: the method, to its own tolerance or to one given in sds, which is all that early rounds
    with terms need; begin: `NoiseEstimate.factors` of nearly the same machine and readings, from
    which the sds settle in a few rounds; roughly: they may stop near where they would settle. By
    default the search begins at the sds that the problem states. The sds of terms begin at the
    prior sds of their parameters.
    """
    spreads = np.array([component.spread for component in components])
    positions = [component.quantities for component in components]
    search = _Search(problem, positions, spreads, fit)
    if begin is not None:
        best = search.run(
            np.square([begin.get(component.name, 1.0) for component in components]),
            warm=True,
            roughly=roughly,
        )
    else:
        begun = [np.ones(len(components))]
        best = search.run(begun[0])
        while (other := search.doubtful(best, begun)) is not None:
            begun.append(other)
            again = search.run(other)
            if again.better_than(best):
                best = again
            elif not (again.fitted or best.fitted):
                break
    status = replace(best.solution.status, iterations=best.iterations)
    return NoiseEstimate(
        with_scales(best.present),
        replace(best.solution, status=status),
        tuple(components),
        problem,
        best.variances,
        best.settled,
        best.prints,
    )


@dataclass(frozen=True)
class _Round:
    """Where a search ended: the problem at its sds, its fit, and what the linearisation says."""

    present: Problem
    solution: Solution
    variances: Variances
    settled: bool
    iterations: int
    prints: Prints | None = None

    @property
    def fitted(self) -> bool:
        """Whether the fit at these sds converged."""
        return self.solution.status.converged

    def better_than(self, other: _Round) -> bool:
        """Whether its likelihood is greater; any fit that converged beats one that did not."""
        if self.fitted != other.fitted:
            return self.fitted
        return self.fitted and self.variances.criterion < other.variances.criterion - _BETTER


@dataclass(frozen=True)
class _Search:
    stated: Problem
    positions: Sequence[Sequence[int]]
    spreads: Array
    fit: Fitting

    @property
    def as_read(self) -> bool:
        """Whether the sums of the fit are those of loops linearised at the readings."""
        return self.stated.weighting is Weighting.READ

    @cached_property
    def common(self) -> bool:
        """Whether all noise is learnt, so that a factor common to it is."""
        return all_learnt(self.stated, self.positions)

    @cached_property
    def by_sums(self) -> bool:
        """Whether the sums over all poses say everything: sensors have one factor, or none."""
        learnt = len(self.positions)
        alone = not learnt or (learnt == 1 and self.common)
        return bool(self.stated.mechanism.learnt_terms) and alone and not self.as_read

    def doubtful(self, end: _Round, begun: Sequence[Array]) -> Array | None:
        """Other ratios to begin from, where the end is far from what was stated; None without any.

        At sds that are wrong by much the first fit may blame the wrong sensor and never get away
        from it. Each sensor that ended far from its stated sd gets a second chance there. begun:
        where searches began already.
        """
        if self.by_sums or _hopeless(end.solution):
            return None
        for i, ratio in enumerate(end.variances.ratios):
            if not 1.0 / _FAR < ratio < _FAR:
                other = end.variances.ratios.copy()
                other[i] = 1.0
                if all(_change(one, other) > NEARBY for one in begun):
                    return other
        return None

    def run(self, ratios: Array, *, warm: bool = False, roughly: bool = False) -> _Round:
        """Fit and variances in turn, from these ratios, until neither moves.

        warm: these are the ratios of nearly the same machine and readings; roughly: they may stop
        near where they would settle. Fits that do not converge end the search, because sds learnt
        where the loops were left mean nothing. A second fit from there is the last attempt.
        """
        start, before, vanish, iterations, failed = self.stated.start, math.inf, warm, 0, 0
        scales, corrections = scales_of(self.stated), self.stated.first_corrections
        rough, last = ROUGH if len(scales) and not roughly else None, math.inf
        turns = list[tuple[Array, Array]]()
        prints = Prints.of(self.stated, near=roughly)
        for number in range(_MOST):
            present = scaled(begun_with(self.stated, scales), self.positions, ratios)
            begun = replace(present, start=start, first_corrections=corrections)
            solution = self.fit(begun) if rough is None else self.fit(begun, tolerance=rough)
            start, iterations = solution.parameters, iterations + solution.status.iterations
            corrections = solution.corrections
            failed = 0 if solution.status.converged else failed + 1
            present = replace(present, start=start)
            # A sensor whose sd is known in part never vanishes.
            lowest = np.where(vanish & np.isinf(self.spreads), 0.0, ratios / _SLOWLY)
            variances = self._variances(present, solution, ratios, lowest, prints)
            bounded = (variances.ratios > 0.0) & (variances.ratios < _LEAST)
            if bounded.any():
                lowest = np.where(bounded, _LEAST, lowest)
                ratios = np.maximum(ratios, lowest)
                variances = self._variances(present, solution, ratios, lowest, prints)
            change = _change(ratios, variances.ratios)
            falling = np.zeros(len(ratios), dtype=bool) if vanish else variances.ratios <= lowest
            others = _change(ratios[~falling], variances.ratios[~falling])
            if variances.terms is not None:
                by_terms = _change(np.square(scales), np.square(variances.terms.scales))
                change, others = max(change, by_terms), max(others, by_terms)
            enough = _SETTLED
            if variances.terms is not None or (prints is not None and prints.kept.any()):
                enough = NEARBY if roughly or number >= _MOST // 2 else NEAR
            # what does not change the criterion, such as a component near zero, is of no account
            ended = change <= enough or abs(before - variances.criterion) <= _BETTER
            if prints is not None and not failed and prints.due(ended=ended, roughly=vanish):
                asking = not roughly and (ended or prints.learnt is None)
                prints = prints.updated(present, solution, common=self.common, asking=asking)
                settled = 10.0 * PRINTED if roughly else PRINTED
                start, ended = prints.held(start), ended and prints.step <= settled
            if ended and vanish and not failed and (roughly or rough is None):
                return _Round(present, solution, variances, variances.converged, iterations, prints)
            if failed > _FAILURES or _hopeless(solution):
                break
            # No component may vanish before the others are roughly right.
            vanish = vanish or ended or others <= _ROUGHLY or number >= _MOST // 2
            before, learnt = variances.criterion, scales
            if variances.terms is not None:
                learnt = variances.terms.scales
                if not roughly:
                    rough = None if ended else min(rough or ROUGH, _SHARE * change)
                elif change > 0.5 * last:  # the end of the fit itself keeps them from settling
                    rough = _SHARE * min(rough or ROUGH, change)
            if falling.any() or math.isinf(change):
                turns.clear()  # such a step is cut off, or has no logarithm
            began = np.concatenate([np.where(ratios > 0.0, ratios, 1.0), np.square(scales)])
            step = np.concatenate([_rise(ratios, variances.ratios), 2.0 * np.log(learnt / scales)])
            turns.append((np.log(began), step))
            part, last = np.exp(_mixed(turns) - step), change
            ratios = variances.ratios * part[: len(ratios)]
            scales = learnt * np.sqrt(part[len(ratios) :])
        return _Round(present, solution, variances, False, iterations, prints)

    def _variances(
        self,
        present: Problem,
        solution: Solution,
        ratios: Array,
        lowest: Array,
        prints: Prints | None,
    ) -> Variances:
        """What the loops say where a fit at these ratios has ended."""
        if self.by_sums:
            return by_common_factor(present, solution, float(ratios[0]) if len(ratios) else None)
        # Ratios are to the stated sds of sensors, so only the prior sds are the present ones.
        model = linear_model(
            replace(self.stated, prior_sd=present.prior_sd),
            solution.parameters,
            solution.corrections,
            self.positions,
            self.spreads.tolist(),
        )
        model = _spent(model, prints, self.stated, self.positions)
        end = None if self.as_read else solution
        return in_turn(present, model, ratios, lowest, common=self.common, end=end)


def scaled(problem: Problem, components: Sequence[Sequence[int]], ratios: Array) -> Problem:
    """The problem with the variances of some quantities multiplied by ratios."""
    factor = np.ones(len(problem.readings))
    for positions, ratio in zip(components, ratios, strict=True):
        factor[list(positions)] = math.sqrt(ratio)
    uncertainty = problem.uncertainty
    # What is not measured stays so: inf times a factor of zero would be no number.
    sd = uncertainty.sd.copy()
    np.multiply(sd, factor[:, None], out=sd, where=np.isfinite(sd))
    blocks = tuple(
        CovarianceBlock(b.indices, b.factor * factor[b.indices[0]]) for b in uncertainty.blocks
    )
    return replace(problem, uncertainty=ReadingUncertainty(sd, blocks, uncertainty.sources))


def _spent(
    model: LinearModel,
    prints: Prints | None,
    problem: Problem,
    positions: Sequence[Sequence[int]],
) -> LinearModel:
    """The model without the equations of corners that offsets of points use up.

    Each component of these positions gives them by its pixels. An image of few corners has no spare
    row to take them from: spare rows are then fewer than none, as where corners are missing.
    """
    if prints is None or not prints.freedom:
        return model
    pixels = {q for f in problem.mechanism.families if f.form == PIXELS for q in f.readings}
    seen = np.isfinite(problem.uncertainty.sd).sum(axis=1)
    seen *= [q in pixels for q in problem.mechanism.tape.quantities]
    count = np.array([*(seen[list(p)].sum() for p in positions), 0.0])
    images = sum(len(block.spare) for block in model.blocks)
    share = prints.freedom * count / max(float(count.sum()), 1.0) / images
    blocks = tuple(replace(block, spare=block.spare - share) for block in model.blocks)
    return replace(model, blocks=blocks)


def _hopeless(solution: Solution) -> bool:
    """Whether the loops do not close by far: a wrong unit or machine, which no sd explains."""
    return not solution.status.converged and solution.chi_squared > _HOPELESS * solution.equations


def _rise(before: Array, after: Array) -> Array:
    """The logarithms of the ratios of variances, 0 where one of both is zero."""
    both = (before > 0.0) & (after > 0.0)
    return np.asarray(np.log(np.where(both, after, 1.0) / np.where(both, before, 1.0)))


def _mixed(turns: list[tuple[Array, Array]]) -> Array:
    """(n,) by how much the logarithms of variances change: to where the last steps together vanish.

    Each fit linearises the loops elsewhere, which may lead past the variances at which fit and
    variances agree: plain steps would swing about them. X and F are the changes of places and of
    steps f from turn to turn. The change is f - (X + F) g with the g of least |f - F g| (Anderson
    1965; Walker and Ni 2011, section 2). Where that is longer than the last steps, these foretell
    nothing: the change is f, and `turns` loses the earlier ones.

    turns: where each began, (n,), and its step (n,).
    """
    del turns[: -_MIXED - 1]
    step = turns[-1][1]
    if len(turns) == 1:
        return step
    X, F = (np.diff([turn[i] for turn in turns], axis=0).T for i in (0, 1))
    move = step - (X + F) @ np.linalg.lstsq(F, step, rcond=_CUT)[0]
    if np.abs(move).max(initial=0.0) > max(np.abs(f).max(initial=0.0) for _, f in turns[-2:]):
        del turns[:-1]
        return step
    return np.asarray(move)


def _change(before: Array, after: Array) -> float:
    if np.any((before > 0.0) != (after > 0.0)):
        return math.inf
    return float(np.abs(_rise(before, after)).max(initial=0.0))


def judged(
    model: LinearModel, estimate: Estimate, which: int, component: Component, unsure: bool
) -> EstimatedSd:
    """What a model says of one component. unsure: whether it is hardly told apart from another."""
    from scipy.special import chdtrc

    ratio, sd = math.sqrt(float(estimate.ratios[which])), estimate.sd_of_root(which)
    upper = None
    if unsure or sd is None or sd > _UNCERTAIN * ratio:
        bound = upper_bound(model, estimate, which)
        upper = None if bound is None else math.sqrt(bound)
    rise = gain_of(model, estimate, which)
    # at the boundary the rise is zero in half of all cases (Self and Liang 1987)
    p_value = None if rise is None else 0.5 * float(chdtrc(1, rise)) if rise > 0.0 else 1.0
    return EstimatedSd(component.name, component.quantities, ratio, sd, upper, rise, p_value)


def gain_of(model: LinearModel, estimate: Estimate, which: int) -> float | None:
    """By how much one component of several lowers -2 log of the likelihood."""
    without = None if len(estimate.ratios) == 1 else without_component(model, estimate, which)
    return None if without is None else max(without - estimate.criterion, 0.0)
