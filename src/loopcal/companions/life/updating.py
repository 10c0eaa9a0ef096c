"""A calibration of another day that begins from what is known already.

Yesterday's parameters p_0 with covariance C are the prior of today's fit, after a drift allowance
Q of what may have changed (`loopcal.companions.life.drift`): with K the contrasts that neither a
moved instrument nor an undetermined direction of yesterday touches, rows of unit variance under
C + Q,

    minimise   Phi(p) + |K (p - p_0)|^2,

Phi the merit of the new poses (`loopcal.estimation.solve.merit`). Where the problem is linear and
nothing moved, the end is that of all poses fitted at once (Kalman 1960): yesterday's poses enter
by their sums.

Sds of sensors from the poses of both days.

Near the machine p of today the misclosures of the earlier poses and of the new ones are

    e_1 = J_1 (p - d) + F_1 a_1 + v_1,    e_2 = J_2 p + F_2 a_2 + v_2,    d ~ N(0, Q),

with what was placed anew (a_1, a_2) free on each day, d the drift, and the prior of the earlier
calibration as further rows. The covariances of v_1 and v_2 share the variances of the sensors,
which the restricted likelihood of both together estimates (Patterson and Thompson 1971): of one
model of all poses, so that no day's estimate has to be summed up by a curvature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.life.drift import (
    CONDITIONS,
    Drifting,
    Since,
    allowed,
    drift_of_conditions,
)
from loopcal.companions.life.earlier import Around, Earlier, Sloped
from loopcal.document.findings import CheckEntry, ScaleEntry
from loopcal.document.fit import NoiseEntry
from loopcal.document.result_document import UPDATED
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.inherited import Inherited
from loopcal.estimation.methods.method import Method
from loopcal.estimation.noise.estimation import judged
from loopcal.estimation.noise.learning import learnt_entry
from loopcal.estimation.noise.linear_model import LinearModel, ModelBlock, linear_model
from loopcal.estimation.noise.variance_components import Component, estimate_ratios
from loopcal.estimation.problem.constants import with_latest
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import Evaluation
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import MOST_ITERATIONS, Solution
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.estimation.steps import LEARNT, Near
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.small_samples import LearntCovariance, contrasts
from loopcal.statistics.another_day import Day, as_learnt, day_problem, noise_of
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.changed import DRIFT_OR_CHANGE
from loopcal.statistics.gauge import values_of
from loopcal.statistics.later_corners import fitting_corners
from loopcal.statistics.replacing import Replaced, freed
from loopcal.statistics.scales import scale_of_all
from loopcal.statistics.shared_repeats import day_as_means
from loopcal.statistics.station_scales import by_same_stations
from loopcal.statistics.verified import Verification

_MIXED = "The update mixes both machines. Calibrate anew, or state the drift that is expected."
_WITHIN = "Update with the poses before that change alone, or those after it, or measure again."
_ON_THE_WAY = "Update with poses that are read while the machine stands."
_TWICE = (
    "{poses} of these poses are those of the calibration itself and count twice: the stated sds "
    "are too small. Update with other poses."
)
_NOTHING, _NEWS = "The update changed no parameter of the machine", 0.01
_ROUNDS, _SETTLED = 12, 2e-2
"""Most fits of an update, each begun near the end of the last. They have settled where parameters
change by less than this share of an sd, and learnt variances by less than this share."""


@dataclass(frozen=True, eq=False)
class Updated:
    """An update. check: whether the new readings are of the machine that was calibrated, after the
    stated drift."""

    result: FitResult
    check: Verification

    @property
    def mixed(self) -> str | None:
        """Why the update mixes two machines; None where it does not."""
        answer = self.check.verdict["consistent"]
        remedy = _WITHIN if self.check.shifts.found else _MIXED
        remedy = _ON_THE_WAY if answer.code == "poses-delayed" else remedy
        return f"{answer.words} {remedy}" if answer.passed is False else None

    @property
    def entry(self) -> CheckEntry | None:
        """What the document of the update has of the check: two machines, or what may have moved
        along the run; None elsewhere."""
        answer, check = self.check.verdict["consistent"], self.check
        along = check.shifts.found or (check.changes and check.changes.verdict == DRIFT_OR_CHANGE)
        if answer.passed or not (answer.passed is False or along):
            return None
        return CheckEntry(answer.passed, answer.words)


def update(
    calibration: FitResult | Calibrated,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    moved: bool = True,
    remounted: bool | Sequence[str] = False,
    drift: Mapping[str, float] | None = None,
) -> FitResult:
    """Calibrate with new readings and what a calibration already knows.

    data: readings [SI] as `calibrate` takes them; noise: their sds, else the calibration's; moved:
    whether instruments stand elsewhere, so that nothing is known of their placement; remounted: as
    in `verify`; drift: sd [SI] by which parameters may have changed since, by role ("length",
    "twist", "zero", "angle", "scale", "mounting", "effect"), joint (its zero) or parameter;
    "length" and "angle" hold all of the machine in that unit. The prior is the covariance of the
    calibration (Kalman 1960), near the end of the update as its poses say (Bell 1994).

    It verifies first (`verify`). Changes that are named there, and explain the readings, are
    estimated anew; warnings of the result name them, or say that the readings are of another
    machine.

    Raises InputError for a calibration or readings without sds, for a role that is not there, and
    for a file at fault, as with exchanged columns.
    """
    return updated(calibration, data, Since(moved, remounted, drift or {}), noise).result


def updated(
    calibration: FitResult | Calibrated, data: Dataset | Any, since: Since, noise: NoiseLike | None
) -> Updated:
    """`update`, with the check of the machine."""
    calibrated = (
        Calibrated.of(calibration, "") if isinstance(calibration, FitResult) else calibration
    )
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    stated = Noise.of(noise)
    if calibrated.residual is not None and stated is None:
        raise InputError(
            "the calibration took its readings as exact, so their sds are unknown",
            code="missing-sd",
            remedy="give noise, or update a calibration by another method",
        )
    calibrated = replace(calibrated, residual=None)
    as_calibrated, calibrated = calibrated, calibrated.loadable.scalable()
    calibrated = calibrated.stationed if since.moved else calibrated
    data = fitting_corners(calibrated, data, stated, since.remounted)
    data, stated = day_as_means(calibrated, data, stated, since.remounted)
    allowance = allowed(calibrated, data, since, stated)
    if faults := allowance.check.faults:
        raise InputError(
            "; ".join(fault.words for fault in faults),
            code="implausible-readings",
            remedy="correct the file; no update can use it as it stands",
        )
    if (gone := np.flatnonzero(np.isin(data.poses, allowance.check.outliers))).size:
        kept = np.setdiff1d(np.arange(len(data)), gone)
        data, stated = data.without_outliers(gone), stated and stated.take(kept)
        allowance = allowed(calibrated, data, since, stated)
    drift, grown, every = allowance.drift, allowance.grown, calibrated.mechanism.parameters.names
    followed = {name for name, row in zip(every, drift, strict=True) if row.any()}
    calibrated = _following(as_calibrated, followed)
    calibrated = (calibrated.stationed if since.moved else calibrated).continuing
    names = calibrated.mechanism.parameters.names
    rows = [every.index(name) for name in names]
    drift, grown = drift[rows], None if grown is None else grown[:, rows]
    held = stated is not None
    if stated is None:
        stated, data = noise_of(calibrated), as_learnt(calibrated, data)
    data = with_latest(calibrated.mechanism, by_same_stations(calibrated.mechanism, data))
    with one_blas_thread():
        day = Day.of(calibrated, data, stated, since.remounted)
        if not since.moved:
            standing = freed(calibrated.mechanism)
            day = replace(day, freed=tuple(n for n in day.freed if n not in standing))
        placed = day.placed()
        # No line from where the calibration was reaches a large change.
        begun = day.placed({n: by for n, by in allowance.moved.items() if n in names})
        after, readings = Drifting(calibrated, data, stated).after(allowance.moved)
        later = replace(day, problem=Day.of(after, readings, stated, since.remounted).problem)
        conditions = drift_of_conditions(replace(later, calibrated=calibrated.drifted(drift)))
        drift = np.hstack([drift, conditions])
        earlier = Earlier.of(calibrated, allowance.moved)
    result: FitResult | None = None
    around, share, stepped = placed.parameters, 1.0, np.zeros(len(placed.parameters))
    for number in range(_ROUNDS):
        with one_blas_thread():
            prior = _Prior.of(calibrated, placed, drift, earlier, around if number else None)
        result = _fitted(calibrated, begun, prior, data, stated, result)
        if not result.status.converged:
            break  # it has no end that a further fit could begin near
        with one_blas_thread():
            sds = None if held else learnt(calibrated, earlier, result, placed.anew, drift)
        if sds is not None:
            calibrated = replace(calibrated, noise=sds.noise)
            stated, earlier = noise_of(calibrated), earlier.at_sds(calibrated)
        settled = sds is None or sds.change < _SETTLED
        step = _step(result, around)
        if number and settled and np.abs(step).max(initial=0.0) < _SETTLED:
            break
        # Along a bend of the valley ends may swing about where they settle.
        share = 0.5 * share if step @ stepped < 0.0 else min(2.0 * share, 1.0)
        around = around + share * (result.solution.parameters - around)
        stepped = step
    assert result is not None
    # It began where the round before it ended; the update begins with the calibration.
    result = replace(result, problem=replace(result.problem, start=placed.parameters))
    with one_blas_thread():
        terms = (
            calibration.terms_with_parts()
            if isinstance(calibration, FitResult)
            else calibrated.terms
        )
        noted = () if held else calibrated.noise
        either = _Either.of(result, grown, prior, placed.anew, allowance.scale)
        handed_on = Inherited(
            prior.widened(result) + either.covariance, terms, noted, calibrated.conditions
        )
        result = replace(result, inherited=handed_on).with_parts(scales=either.scales)
    result = result.noted(*allowance.words, *([CONDITIONS] if conditions.size else []))
    check = allowance.check
    result = result.noted(*filter(None, [check.read_as]), *check.unlike)
    if (words := _unchanged(calibrated, result, placed)) is not None:
        result = result.noted(words)
    if again := allowance.check.repeated:
        result = result.noted(_TWICE.format(poses=again))
    done = Updated(result, allowance.check)
    result = result.with_parts(check=done.entry)
    return replace(done, result=result.noted(*filter(None, [done.mixed])))


def _following(calibrated: Calibrated, names: set[str]) -> Calibrated:
    """The machine with no more than these parameters need: of what the calibration did not have it
    knows nothing, so that the fit would find it anew."""
    loaded = calibrated.loadable
    added = {*loaded.mechanism.parameters.names}.difference(calibrated.mechanism.parameters.names)
    return (loaded if added & names else calibrated).scalable(names)


def _fitted(
    calibrated: Calibrated,
    placed: Replaced,
    prior: _Prior,
    data: Dataset,
    noise: Noise,
    before: FitResult | None,
) -> FitResult:
    """The fit of these readings with the prior, begun where the machine stands or where it ended
    before."""
    method = Method(
        name="implicit-loop",
        label=UPDATED,
        description="Implicit loop: every sensor is uncertain, and an earlier calibration is the "
        "prior.",
        solve=partial(_solved, prior=prior),
    )
    names = calibrated.mechanism.parameters.names
    begun = replace(calibrated.mechanism, terms=()).with_nominal(
        dict(zip(names, placed.parameters.tolist(), strict=True))
    )
    sds = {names[i]: float(sd) for i, sd in zip(prior.free, prior.sds, strict=True)}
    begun = begun.with_parameters(begun.parameters.with_prior(sds))
    start = "nominal" if before is None else before.value
    # Where the machine already closes the loops of the new poses; the fit begins there.
    values = placed.problem.readings + placed.corrections
    near = dict(zip(placed.problem.mechanism.tape.quantities, values, strict=True))
    how = Fit(method=method, start=start, tolerance=LEARNT)
    return calibrate(begun, data, noise=noise, fit=how, near=Near(near), trusted=True)


def _step(result: FitResult, centre: Array) -> Array:
    """The way (n_all,) from parameters centre (n_all,) to a fit [sds]."""
    sd = np.zeros(len(centre))
    sd[result.problem.free] = np.sqrt(np.diag(result.spectrum.covariance()))
    return np.asarray((result.solution.parameters - centre) / np.where(sd > 0.0, sd, np.inf))


def _unchanged(calibrated: Calibrated, result: FitResult, placed: Replaced) -> str | None:
    """That the update says nothing new of the machine; None where it does."""
    names, before = calibrated.mechanism.parameters.names, np.diag(calibrated.covariance.matrix)
    kept = [
        i for i, n in enumerate(names) if n in result.estimated and not placed.anew[i] and before[i]
    ]
    if not kept:
        return f"{_NOTHING}: the calibration estimates none that the update keeps."
    sds = np.sqrt(before[kept])
    was = values_of(calibrated.mechanism)
    now = np.array([result.value[names[i]] - was[i] for i in kept])
    sure = np.array([result.sd[names[i]] or np.inf for i in kept])
    if (np.abs(now) < _NEWS * sds).all() and (sure > (1.0 - _NEWS) * sds).all():
        return (
            f"{_NOTHING}: values and sds are within {100 * _NEWS:g} % of an sd of the "
            "calibration's. Measure more poses, or state the drift that is expected."
        )
    return None


@dataclass(frozen=True, eq=False)
class _Prior:
    """What a calibration knows of the estimated parameters: |rows (phi(p) - m)|^2.

    rows: (q, n) of unit variance; centre: (n_all,) where m stands; free: (n,) positions; moved:
    (n_all,) by how much today's machine is elsewhere than then; sds: (n,) of single parameters, inf
    where they are found anew; wider: (q, q) by how much the covariance of
    the rows is larger than the information of the calibration says; around, follows: phi.
    """

    rows: Array
    centre: Array
    free: NDArray[np.intp]
    moved: Array
    sds: Array
    wider: Array
    around: Around
    follows: Array

    @classmethod
    def of(
        cls,
        calibrated: Calibrated,
        placed: Replaced,
        drift: Array,
        earlier: Earlier,
        centre: Array | None,
    ) -> _Prior:
        """The covariance with the drift, where the machine stands now.

        centre: (n_all,) what is near the end of the fit; None: the calibration.
        """
        free = np.flatnonzero([not p.fixed for p in calibrated.mechanism.parameters])
        around = earlier.around(earlier.begin)
        if centre is not None:
            around = earlier.beside(centre, placed.anew)
        held = ~placed.anew[:, None]
        root, drift = (around.root * held)[free], (drift * held)[free]
        C = root @ root.T + drift @ drift.T
        loose = (calibrated.undetermined * held)[free]
        open_ = np.hstack([loose, np.eye(len(C))[:, placed.anew[free]]])
        rows, sd = contrasts(LearntCovariance.certain(C), open_), np.sqrt(np.diag(C))
        carried = rows @ (around.carried * held)[free]
        informed = (np.abs(rows).max(axis=0, initial=0.0) > 0.0) & (sd > 0.0)
        stands = np.where(placed.anew, placed.parameters, around.mean)
        stands = placed.parameters if around.seen is None and centre is None else stands
        return cls(
            rows,
            stands + earlier.moved,
            free,
            earlier.moved,
            np.where(informed, sd, np.inf),
            carried @ earlier.wider(calibrated) @ carried.T,
            around,
            around.follows(placed.anew),
        )

    def at(self, parameters: Array) -> Sloped:
        """The rows (q,) and their derivatives (q, n)."""
        around, free = self.around, self.free
        if around.seen is None:
            return Sloped(self.rows @ (parameters - self.centre)[free], self.rows)
        then = around.mean + self.follows @ (parameters - self.moved - around.mean)
        coordinates = around.seen.at(then)
        away = coordinates.values - (around.mean - around.centre)
        slopes = (coordinates.slopes @ self.follows)[np.ix_(free, free)]
        return Sloped(self.rows @ away[free], self.rows @ slopes)

    def widened(self, result: FitResult) -> Array:
        """(n, n) what the covariance of a fit gains: G wider G^T, G its change with the rows."""
        gain = result.spectrum.covariance() @ self.at(result.solution.parameters).slopes.T
        wider: Array = gain @ self.wider @ gain.T
        return wider


@dataclass(frozen=True, eq=False)
class _Either:
    """A scale s that is followed: that of the machine changed, or that of what measures it.

    These poses do not show which. Of the machine the truth is s, of the instrument 0, each as
    likely: about the estimate s that is a variance of s^2 / 2, along all that a scale changes. With
    K the rows of the prior, r = K (p - p_0) and g what a scale of the machine alone changes, s is
    that of generalised least squares, s = g^T K^T r / |K g|^2: parts that the earlier poses hardly
    knew say little of it. Where the whole machine is let drift besides, it takes up a scale as
    well, and the one that the check named counts.
    covariance: (n, n) [SI] that it adds to the estimated parameters; scales: of the document.
    """

    covariance: Array
    scales: tuple[ScaleEntry, ...] = ()

    @classmethod
    def of(
        cls,
        result: FitResult,
        grown: Array | None,
        prior: _Prior,
        anew: NDArray[np.bool_],
        named: tuple[float, float] | None,
    ) -> _Either:
        """grown: (2, n_all), see `Drifting.grown`; anew: (n_all,) what was placed anew; named: the
        scale that the check named, and its sd."""
        free = list(result.problem.free)
        if grown is None or not (kept := np.where(anew, 0.0, grown)[:, free]).any():
            return cls(np.zeros((len(free), len(free))))
        machine, every = kept
        change = prior.at(result.solution.parameters)
        along = change.slopes @ machine
        weights = along @ change.slopes / (along @ along)
        since = change.values + change.slopes @ prior.moved[prior.free]
        scale = along @ since / (along @ along)
        sd = np.sqrt(weights @ result.spectrum.covariance() @ weights)
        if named is not None and abs(named[0]) > abs(scale):
            scale, sd = named
        entry = scale_of_all(result.problem, float(scale), float(sd))
        return cls(0.5 * scale**2 * np.outer(every, every), (entry,))


class _WithPrior(InMemory):
    """The merit of poses in memory, and the prior as further equations."""

    def __init__(self, sweeper: Sweeper, prior: _Prior) -> None:
        super().__init__(sweeper)
        self.unknowns: Unknowns = self.unknowns.without_prior()
        self.evaluate = partial(_evaluated, sweeper, prior)


def _evaluated(
    sweeper: Sweeper, prior: _Prior, parameters: Array, corrections: Array, **how: Any
) -> Evaluation[Array]:
    """A sweep over the new poses, to which the prior is added."""
    evaluation = sweeper.sweep(parameters, corrections, **how)
    prior_rows = prior.at(parameters)
    # The prior's rows as one more pose: derivatives and minus the residual, as a sweep adds them.
    evaluation.data.add(np.vstack([prior_rows.slopes.T, -prior_rows.values])[:, :, None])
    return evaluation


def _solved(
    problem: Problem,
    *,
    prior: _Prior,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The fit of these poses with the prior, whose own equations no loss weighs."""
    with one_blas_thread():
        return solve_with(
            _WithPrior(Sweeper(problem, loss=loss), prior),
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )


@dataclass(frozen=True, eq=False)
class Sds:
    """noise: the entries of all sensors, with new sds; change: largest logarithm of a ratio of
    variances of a sensor that has noise."""

    noise: tuple[NoiseEntry, ...]
    change: float


def learnt(
    calibrated: Calibrated,
    earlier: Earlier,
    result: FitResult,
    anew: NDArray[np.bool_],
    drift: Array,
) -> Sds | None:
    """The learnt sds of a calibration, learnt from its poses and those of an update.

    earlier: at the sds of the update; result: the update; anew: (n_all,) what was placed anew;
    drift: (n_all, k) steps of one sd. None where no sd was learnt, the earlier poses are not
    there, or the loops have no noise.
    """
    which = [i for i, entry in enumerate(calibrated.noise) if _begun(entry) is not None]
    if not which or earlier.problem is None:
        return None
    begun = {i: _begun(calibrated.noise[i]) or 0.0 for i in which}
    apart = tuple(
        replace(entry, sd=begun[i]) if i in begun else entry
        for i, entry in enumerate(calibrated.noise)
    )
    reference = replace(calibrated, noise=apart)
    names = result.problem.mechanism.tape.quantities
    components = [
        Component(", ".join(entry.quantities), tuple(names.index(q) for q in entry.quantities))
        for entry in (calibrated.noise[i] for i in which)
    ]
    model = _model(components, reference, result, earlier, anew, drift)
    # Ratios are of variances to those at which the loadings are made.
    start = np.square([calibrated.noise[i].sd / begun[i] for i in which])
    try:
        estimate = estimate_ratios(model, start)
    except NoTrustworthyResult:
        return None
    noise, ratios = list(calibrated.noise), estimate.ratios
    values, errors = np.linalg.eigh(estimate.at.information * np.outer(ratios, ratios))
    # Of logarithms of variances, which change by 1 where these poses leave them open.
    errors /= np.sqrt(np.maximum(values, 1.0))
    for j, i in enumerate(which):
        unsure = any(j in pair for pair in estimate.alike)
        learnt_sd = judged(model, estimate, j, components[j], unsure)
        entry = learnt_entry(noise[i], learnt_sd, begun[i])
        noise[i] = replace(entry, slopes=tuple(errors[j].tolist()) if entry.sd > 0.0 else ())
    noisy = (start > 0.0) & (estimate.ratios > 0.0)
    change = np.abs(np.log(estimate.ratios[noisy] / start[noisy])).max(initial=0.0)
    vanished = bool(((start > 0.0) != (estimate.ratios > 0.0)).any())
    return Sds(tuple(noise), np.inf if vanished else float(change))


def _begun(entry: NoiseEntry) -> float | None:
    """The sd that a search begins at: of one that was learnt, else None."""
    if entry.source != "estimated":
        return None
    return entry.sd or entry.upper or None


def _model(
    components: Sequence[Component],
    reference: Calibrated,
    result: FitResult,
    earlier: Earlier,
    anew: NDArray[np.bool_],
    drift: Array,
) -> LinearModel:
    """One model of all poses: steps of today's parameters, of what stood elsewhere, and drifts.

    reference: at the sds whose ratios are sought.
    """
    today = day_problem(reference, result.dataset, noise_of(reference))
    positions = [component.quantities for component in components]
    parameters = result.solution.parameters
    new = linear_model(
        today, parameters, result.solution.corrections, positions, compressed=False
    ).blocks
    parameters_then = earlier.parameters_then(parameters, anew)
    old = earlier.linear(reference, parameters_then, positions)
    free = np.array([not p.fixed for p in result.mechanism.parameters])
    every = np.eye(len(parameters))
    shared, placed = every[:, free & ~anew], every[:, free & anew]
    drift = drift * ~anew[:, None]
    stood = every[:, free & anew & earlier.estimated]
    of_today = np.hstack([shared, placed, np.zeros_like(stood), np.zeros_like(drift)])
    # d = p - drift: the earlier poses saw the machine before it drifted.
    of_then = np.hstack([shared, np.zeros_like(placed), stood, -drift])
    n, prior = of_today.shape[1], earlier.prior(parameters_then)
    k = drift.shape[1]
    unit = np.hstack([np.zeros((k, n - k)), np.eye(k)])
    blocks = (
        *(block.by(block.J @ of_today) for block in new),
        *(block.by(block.J @ of_then) for block in old),
        *_rows(Sloped(prior.values, prior.slopes @ of_then)),
        *_rows(Sloped(np.zeros(k), unit)),
    )
    return LinearModel(blocks, np.zeros(n), np.zeros(n), np.full(len(components), np.inf))


def _rows(prior: Sloped) -> tuple[ModelBlock, ...]:
    """Rows of unit variance, as poses whose covariance is known."""
    q = len(prior.values)
    none = np.zeros(0, dtype=np.intp)
    rows = np.column_stack([prior.slopes, prior.values])[:, None]
    block = ModelBlock(rows, np.ones((q, 1, 1)), np.zeros((q, 1, 0)), none)
    return (block,) if q else ()
