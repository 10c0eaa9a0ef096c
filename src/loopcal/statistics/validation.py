"""Validation without truth: poses that took no part in a fit, predicted by it.

Each part of the data is left out once, the rest is calibrated anew by the same method (its sds
estimated anew, where they are estimated at all), and the outputs of the poses left out are
computed from their other readings. Stone (1974), cross-validatory choice and assessment of
statistical predictions. The refits begin at the solution of all poses, which saves iterations
and gives nothing away: the optimum does not depend on where the search began. Where a part
leaves a direction undetermined, it would; there the refit begins where the first fit did. Whether
residuals of neighbouring poses depend is asked of all poses once, not of each part again, and a
drift that all poses show is that of each part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from loopcal.arrays import Array
from loopcal.document.accuracy import BoardPlace, Coverage, FailedPart, ValidationEntry
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import Accuracy, accuracy, by_pose, deviations
from loopcal.estimation.dependence.dependence import Drifting
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.leaving_out import Beginning, LeavingOut, settled
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.problem import Weighting
from loopcal.estimation.problem.problem import taken as taken_poses
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.steps import Near, begun_near
from loopcal.execution.executor import Executor, Progress, gathered
from loopcal.execution.forked import process_cores
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.presentation.shown import brief
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.case import NEAR, Case, taken
from loopcal.statistics.folds import (
    Index,
    Parts,
    Scheme,
    SchemeOptions,
    blocks_of,
    grouped,
    parts_of,
    stated_sds,
)
from loopcal.statistics.predictive import (
    LEVEL,
    Held,
    Predictive,
    Run,
    held_problem,
    predictive,
    unmeasured_corrections,
)
from loopcal.statistics.replacing import freed

# Record 0061.
NEARLY = 1e-2
"""Where sds of terms are learnt, or weights are found in rounds, refits converge to so many sds: no
prediction moves by more than a hundredth of its error."""
# Chosen, not derived: far below what a prediction shows.
ENOUGH = 1e-5
"""Elsewhere: no prediction moves by more than a hundred-thousandth of its error."""
_SILENT = "the other poses do not limit where it lies"


@dataclass(frozen=True, eq=False)
class Validation:
    """How well poses were predicted that took no part in the fit.

    scheme: what was left out, as asked; words: the same for the reader; accuracy: of the outputs
    computed from the other readings, over all poses left out, None where no pose has both;
    log_likelihood: sum over these poses of log N(misclosure; 0, W + D Cov_p D^T) in the units of
    the loop equations, None where the method has no distribution for it; by_pose: (N,) its
    terms, distances: (N,) between computed and measured outputs, both in the order of `poses`;
    parts: how many parts were to be predicted; failed: those whose fit failed, which do not count;
    silent: those whose fit states no regions; inside: (N,) 1 where the measured point lies in its
    stated region of probability `LEVEL`, else 0, NaN where a pose has none, None where no part
    states any; places: of the boards that
    cameras see; blocked: the same for regions of the joint space left out one by one, None where
    that was not asked for; images: the same for regions of the image; groups: (N,) of poses that
    were never split, such as repeats of one pose.
    """

    __repr__ = brief

    scheme: Mapping[str, Any]
    words: str
    accuracy: Accuracy | None
    log_likelihood: float | None
    poses: tuple[str, ...] = ()
    distances: Array | None = None
    by_pose: Array | None = None
    parts: int = 1
    failed: tuple[FailedPart, ...] = ()
    inside: Array | None = None
    places: tuple[BoardPlace, ...] = ()
    blocked: Validation | None = None
    images: Validation | None = None
    groups: Index | None = None
    silent: tuple[FailedPart, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which parts could not be predicted, and why."""
        return self.entry.warnings

    @property
    def coverage(self) -> Coverage | None:
        """How often the stated regions hold; None where the method states none.

        Poses of one group share the error of the fit that predicted them: together they are one.
        """
        if self.inside is None or not (judged := np.isfinite(self.inside)).any():
            return None
        groups = np.arange(len(judged)) if self.groups is None else self.groups
        _, of = np.unique(groups[judged], return_inverse=True)
        shares = np.bincount(of, self.inside[judged]) / np.bincount(of)
        return Coverage(LEVEL, float(shares.mean()), len(shares))

    @property
    def entry(self) -> ValidationEntry:
        """As a document holds it."""
        pooled_accuracy = self.accuracy
        turned = None if pooled_accuracy is None else pooled_accuracy.orientation
        return ValidationEntry(
            dict(self.scheme),
            self.words,
            len(self.poses),
            None if pooled_accuracy is None else pooled_accuracy.distances,
            self.log_likelihood,
            None if turned is None else turned.distances,
            () if pooled_accuracy is None else tuple(one.entry for one in pooled_accuracy.by),
            self.parts,
            self.failed,
            self.coverage,
            self.places,
            None if self.blocked is None else self.blocked.entry,
            None if self.images is None else self.images.entry,
            self.silent,
        )


class ValidationOptions(FitOptions, SchemeOptions, total=False):
    """The fields of `Fit` and of `Scheme` as keyword arguments."""


def validated(
    case: Case,
    whole: FitResult,
    scheme: Scheme,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Validation:
    """The validation of a case whose calibration of all poses is at hand.

    executor: who does the refits, by default the cores of this process; progress: called with how
    many refits are done. Raises as `loopcal.statistics.validate.validate`.
    """
    if scheme.other is not None:
        other = scheme.other
        noise = case.noise if scheme.other_noise is None else Noise.of(scheme.other_noise)
        name = other.source.name or "other readings"
        held = held_problem(whole, other, noise)
        part = _predicted(whole, held, np.arange(len(other)))
        words = f"{len(other)} poses of {name}"
        return _pooled(
            whole, [part], Parts((), {"file": name}, words), other, _all_stated(whole, [part])
        )
    plan = planned(case, scheme)
    made = left_out([(case, whole)], plan.indices, executor, progress, anew=plan.anew)
    return pooled(whole, made[0], plan, case.data)


@dataclass(frozen=True, eq=False)
class Plan:
    """Which poses of a case are left out together: at random, and by regions where asked for.

    groups: (N,) of poses that are never split; anew: whether each part places the instrument.
    """

    random: Parts
    blocked: Parts | None
    groups: Index
    anew: bool = False

    @property
    def indices(self) -> tuple[Index, ...]:
        """All parts, those at random first."""
        return (*self.random.indices, *(self.blocked.indices if self.blocked else ()))


def planned(case: Case, scheme: Scheme) -> Plan:
    """The parts that a scheme leaves out of the readings of a case.

    Raises InputError for a choice that cannot be made.
    """
    sds = stated_sds(case.noise, case.mechanism, case.data)
    groups = grouped(case.mechanism, case.data, scheme.groups, sds)
    blocked = blocks_of(scheme, case.mechanism, case.data, groups) if scheme.blocks else None
    parts = parts_of(scheme, case.data, groups)
    if scheme.place_anew and freed(case.mechanism):
        placed = "the instrument is placed by the readings of the group"
        parts = replace(parts, words=f"{parts.words}; {placed}")
    return Plan(parts, blocked, groups, scheme.place_anew)


def left_out(
    fitted: Sequence[tuple[Case, FitResult]],
    indices: Sequence[Index],
    executor: Executor | None = None,
    progress: Progress | None = None,
    *,
    anew: bool = False,
    stepped: bool = False,
) -> list[list[Outcome]]:
    """For each case each part predicted by a fit of all other poses, in their order.

    fitted: cases with their calibrations of all poses; executor: by default the cores of this
    process; anew: whether the readings of the part say where its instrument stands; stepped:
    whether steps from the fit of all will do where they end the fit (record 0061).
    """
    begun = [replace(_Begun.at(case, whole), anew=anew, stepped=stepped) for case, whole in fitted]
    for one in begun:
        one.prepare()
    pieces = [(which, index) for which in range(len(begun)) for index in indices]
    made = gathered(executor or process_cores(), _left_out, begun, pieces, progress)
    return [made[i * len(indices) : (i + 1) * len(indices)] for i in range(len(begun))]


def refitted(
    case: Case, whole: FitResult, made: Sequence[Outcome], executor: Executor | None = None
) -> list[Outcome]:
    """The same parts, each that steps predicted by a fit that begins where these ended."""
    begun = _Begun.at(case, whole)
    steps = {i: p for i, p in enumerate(made) if isinstance(p, Predicted) and p.near is not None}
    fits = gathered(executor or process_cores(), _fitted, begun, [*steps.values()])
    by_position = dict(zip(steps, fits, strict=True))
    return [by_position.get(i, part) for i, part in enumerate(made)]


def pooled(
    whole: FitResult, made: Sequence[Outcome], plan: Plan, data: Dataset, *, stating: bool = True
) -> Validation:
    """The parts of a plan together; stating: with what the fits stated of them.

    Raises NoTrustworthyResult where no part at random could be predicted.
    """
    count = len(plan.random.indices)
    predictives = _all_stated(whole, made) if stating else None
    groups = None if plan.anew else plan.groups
    validation = _pooled(
        whole, made[:count], plan.random, data, predictives and predictives[:count], groups
    )
    if plan.blocked is None:
        return validation
    try:
        blocked = _pooled(
            whole, made[count:], plan.blocked, data, predictives and predictives[count:], groups
        )
        return replace(validation, blocked=blocked)
    except NoTrustworthyResult:
        return validation


@dataclass(frozen=True, eq=False)
class Asked:
    """What the keyword arguments of `validate` ask for."""

    fit: Fit
    scheme: Scheme

    @classmethod
    def of(cls, fit: Fit | None, options: ValidationOptions) -> Asked:
        """Settings and scheme; keyword arguments override the settings."""
        settings: dict[str, Any] = dict(options)
        scheme = {
            name: settings.pop(name) for name in SchemeOptions.__annotations__ if name in settings
        }
        return cls(Fit.of(fit, cast(FitOptions, settings)), Scheme(**scheme))


@dataclass(frozen=True)
class Predicted:
    """Poses that a fit has not seen, n of them, at these positions.

    measured, differences (c, n) [SI]: what is compared, and computed minus measured ones; fit,
    held: the fit and these poses, None where it states nothing of them; rest: positions of the
    poses of the fit, None where these poses are of another run; regions: what was stated where
    the instrument was placed by these poses; near: where a fit begins that states something of
    them, None where that is at hand.
    """

    index: Index
    measured: Array
    differences: Array
    fit: FitResult | None = None
    held: Held | None = None
    rest: Index | None = None
    regions: Predictive | None = None
    near: Case | None = None

    def stated(self, drifting: Drifting | None) -> Predictive | None:
        """What the fit stated of them under the drift of all poses; None where it states nothing.

        Computed on request: it costs as much as the fit, and what loses a choice never needs it.
        """
        if self.fit is None or self.held is None:
            return self.regions
        # What follows from the fit is large, and goes with these copies.
        estimate = None if self.fit.estimate is None else replace(self.fit.estimate)
        fit = replace(self.fit, estimate=estimate)
        try:
            with one_blas_thread():
                run = None if self.rest is None else Run(self.rest, self.index)
                return predictive(fit, self.held, drifting, run)
        except (InputError, NoTrustworthyResult):
            return None


@dataclass(frozen=True)
class Failed:
    """Poses at these positions that could not be predicted, and why."""

    index: Index
    reason: str


Outcome = Predicted | Failed
"""What became of a part."""


def unread(whole: FitResult) -> dict[str, Array]:
    """Values (N,) [SI] where a fit ended, of quantities that some pose has no reading of."""
    problem, names = whole.problem, whole.mechanism.tape.quantities
    return {
        q: problem.readings[i] + whole.corrections[q]
        for i, q in enumerate(names)
        if q in whole.corrections and np.isinf(problem.uncertainty.sd[i]).any()
    }


@dataclass(frozen=True)
class _Begun:
    """What the fits of all parts share: the calibration, and where that of all poses ended.

    leaving: from that of all poses, None where a fit without some of them cannot begin one step
    from it; anew: whether a part places its instrument; stepped: whether steps may do.
    """

    case: Case
    near: Case
    leaving: LeavingOut | None = None
    anew: bool = False
    stepped: bool = False

    @classmethod
    def at(cls, case: Case, whole: FitResult) -> _Begun:
        """Parameters and learnt sds of the calibration of all poses."""
        # A start, not a value: held sds would hide what they fit too well (record 0061).
        learnt = whole.estimate
        factors = learnt.factors if learnt is not None and learnt.settled else None
        # the mechanism of the calibration has the prior already
        fit = replace(case.fit, start=dict(whole.value), prior=None)
        rough = bool(whole.mechanism.learnt_terms) or fit.solver.weighting is Weighting.READ
        enough = NEARLY if rough else ENOUGH
        most = min(fit.max_iterations, NEAR)
        fit = replace(fit, tolerance=fit.tolerance or enough, max_iterations=most)
        # A rival that does not arrive without some poses is no reason to wait (record 0157).
        limit = min(case.fit.max_iterations, max(NEAR, 2 * whole.status.iterations))
        case = replace(case, fit=replace(case.fit, max_iterations=limit))
        same = len(case.data) == whole.problem.count  # no copied rows went
        begin = Near(unread(whole) if same else {}, factors)
        near = Case(whole.mechanism, case.data, case.noise, fit, near=begin)
        plain = fit.robust_loss is None and fit.solver.weighting is not Weighting.READ
        return cls(case, near, LeavingOut(whole) if same and plain else None)

    def prepare(self) -> None:
        """Compute what all parts share, ahead of the copies of this process."""
        if self.leaving is not None:
            with one_blas_thread():
                _ = self.leaving.sensors

    def without(self, begun: Beginning | None) -> Case:
        """The case that begins where a fit without some poses will end, nearly."""
        case = self.near
        if begun is None:
            return case
        assert case.near is not None
        near = replace(case.near, factors=begun.factors) if case.near.factors else case.near
        fit = replace(case.fit, start=dict(begun.values))
        return replace(case, mechanism=begun.problem.mechanism, fit=fit, near=near)

    def different(self, index: Index) -> Index:
        """Those of these positions that are no copies; all where only copies are left out."""
        first = index[~np.isin(index, self.near.copied)]
        return first if first.size else index

    def unread(self, index: Index) -> Mapping[str, Array]:
        """Values [SI] of what no sensor reads in the poses at these positions."""
        assert self.near.near is not None
        return self.near.near.take(index).unread

    def step(self, begun: Beginning, gone: Index) -> Predicted | None:
        """These poses, predicted some steps from the fit of all; None where that does not do."""
        if not self.stepped or self.anew or self.leaving is None:
            return None
        whole, tolerance = self.leaving.whole, self.near.fit.tolerance
        assert tolerance is not None
        end = None
        if whole.mechanism.outputs:  # else what the fit states of them is compared
            end = settled(whole, begun, gone, tolerance)
        if end is None:
            return None
        held = replace(taken_poses(whole.problem, gone), first_corrections=None)
        if unread := self.unread(gone):
            held = begun_near(held, unread)
        held = replace(held, start=end)
        made = _predicted(whole, Held(held, unmeasured_corrections(held, end)), gone)
        near = self.without(replace(begun, parameters=end))
        return replace(made, fit=None, held=None, near=near)

    def calibrated(self, gone: Index, near: Case) -> FitResult:
        """The calibration without these poses, begun near where it will end."""
        index = np.setdiff1d(np.arange(len(self.case.data)), gone)
        refit = near.calibrated(index)
        # An open direction would stay where the poses left out have put it.
        if refit.spectrum.rank < len(refit.estimated) or not refit.status.converged:
            return self.case.calibrated(index)
        return refit


def _left_out(every: Sequence[_Begun], piece: tuple[int, Index]) -> Outcome:
    """The poses at these positions, predicted by a fit of the others; copies of rows count once."""
    which, index = piece
    begun = every[which]
    with one_blas_thread():
        try:
            beginning = None if begun.leaving is None else begun.leaving.begun(index)
            if beginning is not None and (made := begun.step(beginning, index)) is not None:
                return made
        except (InputError, NoTrustworthyResult) as error:
            return Failed(begun.different(index), error.message)
        return _refitted(begun, index, begun.without(beginning))


def _fitted(begun: _Begun, part: Predicted) -> Outcome:
    """A part that steps predicted, by a fit that begins where these ended."""
    assert part.near is not None
    with one_blas_thread():
        return _refitted(begun, part.index, part.near)


def _refitted(begun: _Begun, gone: Index, near: Case) -> Outcome:
    """The poses at these positions, predicted by a fit of the others that begins near its end."""
    case, index = begun.case, begun.different(gone)
    try:
        refit = begun.calibrated(gone, near)
        if not refit.status.converged:
            return Failed(index, f"the fit did not converge ({refit.status.reason})")
        part, noise = case.data.take(index), taken(case.noise, index)
        if begun.anew:
            return _placed_anew(refit, part, noise, index)
        held = held_problem(refit, part, noise, begun.unread(index))
        rest = np.setdiff1d(np.arange(len(case.data)), [*gone, *begun.near.copied])
        return replace(_predicted(refit, held, index), rest=rest)
    except (InputError, NoTrustworthyResult) as error:
        return Failed(index, error.message)


def _all_stated(whole: FitResult, made: Sequence[Outcome]) -> list[Predictive | None]:
    """What was stated of each part."""
    return gathered(process_cores(), _stated, whole.drifting, made)


def _stated(drifting: Drifting | None, part: Outcome) -> Predictive | None:
    return part.stated(drifting) if isinstance(part, Predicted) else None


def _predicted(fit: FitResult, held: Held, index: Index) -> Predicted:
    rows = [fit.mechanism.tape.quantities.index(q) for q in fit.mechanism.compared]
    differences = output_differences(held.problem, held.problem.start, held.corrections)
    return Predicted(index, held.problem.readings[rows], differences, fit, held)


def _placed_anew(fit: FitResult, data: Dataset, noise: Noise | None, index: Index) -> Predicted:
    """With every instrument placed by the readings of these poses; all else is held.

    Stated is the region of each pose, less what the placement takes up of it; not their
    probability, for they say where the instrument stands.
    """
    calibrated = Calibrated.of(fit, "").predicting(data).stationed
    stated_noise = None if noise is None or noise.estimate else noise
    linear = Day.of(calibrated, data, stated_noise).linearised()
    placement, seen = linear.placement, linear.by_pose()
    stated = Predictive(None, seen.squares, seen.loops, np.full(len(index), linear.noise))
    return Predicted(index, placement.measured, placement.differences, regions=stated)


def _pooled(
    whole: FitResult,
    made: Sequence[Outcome],
    parts_left: Parts,
    data: Dataset,
    predictives: Sequence[Predictive | None] | None,
    groups: Index | None = None,
) -> Validation:
    """The parts together; predictives: what was stated of each, None where it was not asked for;
    groups: (N,) of all poses, whose poses count as one."""
    mechanism, words = whole.mechanism, parts_left.words
    failed = tuple(
        FailedPart(number, len(part.index), part.reason)
        for number, part in enumerate(made, 1)
        if isinstance(part, Failed)
    )
    parts = [part for part in made if isinstance(part, Predicted)]
    if not parts:
        raise NoTrustworthyResult(
            f"no part could be predicted ({words}): {failed[0].reason}",
            code="not-converged",
            remedy="use fewer folds, or check the summary of the fit of all poses",
        )
    if failed:
        kind = "blocks" if "blocks" in parts_left.stated else "folds"
        words += f"; {len(parts)} of {len(made)} {kind} predicted"
    measured, differences = np.full((2, len(mechanism.compared), len(data)), np.nan)
    terms, inside = np.full((2, len(data)), np.nan)
    judged, probable = False, predictives is not None
    silent: list[FailedPart] = []
    every = zip(made, predictives or [None] * len(made), strict=True)
    for number, (part, stated) in enumerate(every, 1):
        if isinstance(part, Failed):
            continue
        measured[:, part.index] = part.measured
        differences[:, part.index] = part.differences
        if stated is None:
            probable = False
            silent.append(FailedPart(number, len(part.index), _SILENT))
            continue
        judged = True
        inside[part.index] = stated.inside()
        if stated.log_density is None:
            probable = False
        else:
            terms[part.index] = stated.log_density
    apart = deviations(mechanism, measured, differences)
    off = by_pose(apart)
    predicted = np.unique(np.concatenate([part.index for part in parts]))
    return Validation(
        MappingProxyType(dict(parts_left.stated)),
        words,
        accuracy(apart),
        float(terms[predicted].sum()) if probable else None,
        tuple(data.poses[i] for i in predicted),
        None if off is None else off[predicted],
        terms[predicted] if probable else None,
        len(made),
        failed,
        inside[predicted] if judged else None,
        _places(whole, data, differences) if predictives is not None else (),
        groups=None if groups is None else groups[predicted],
        silent=tuple(silent) if judged else (),
    )


def _places(whole: FitResult, data: Dataset, differences: Array) -> tuple[BoardPlace, ...]:
    """Of differences (c, N); none where the fit had other poses."""
    if whole.problem.poses != data.poses:
        return ()
    places = (sight.place(differences) for sight in whole.sights)
    return tuple(place for place in places if place)
