"""Validation without truth: poses that took no part in a fit, predicted by it.

Each part of the data is left out once, the rest is calibrated anew by the same method (its sds
estimated anew, where they are estimated at all), and the outputs of the poses left out are
computed from their other readings. Stone (1974), cross-validatory choice and assessment of
statistical predictions. The refits begin at the solution of all poses, which saves iterations
and gives nothing away: the optimum does not depend on where the search began. Where a part
leaves a direction undetermined, it would; there the refit begins where the first fit did. Whether
residuals of neighbouring poses depend is asked of all poses once, not of each part again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from loopcal.document.accuracy import Coverage, FailedPart, ValidationEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import validation_table
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import Accuracy, accuracy, by_pose, deviations
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.result import Result
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.execution.executor import Executor, Progress, gathered
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.blocks import blocks_of
from loopcal.statistics.folds import (
    Index,
    Parts,
    Scheme,
    SchemeOptions,
    grouped,
    parts_of,
    stated_sds,
)
from loopcal.statistics.predictive import LEVEL, Held, Predictive, held_problem, predictive, taken

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Validation:
    """How well poses were predicted that took no part in the fit.

    scheme: what was left out, as asked; words: the same for the reader; accuracy: of the outputs
    computed from the other readings, over all poses left out, None where no pose has both;
    log_likelihood: sum over these poses of log N(misclosure; 0, W + D Cov_p D^T) in the units of
    the loop equations, None where the method has no distribution for it; by_pose: (N,) its
    terms, distances: (N,) between computed and measured outputs, both in the order of `poses`;
    parts: how many parts were to be predicted; failed: those whose fit failed, which do not count;
    inside: (N,) 1 where the measured point lies in its stated region of probability `LEVEL`, else
    0, NaN where a pose has none, None where the method states none; blocked: the same for regions
    of the joint space left out one by one, None where that was not asked for.
    """

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
    blocked: Validation | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which parts could not be predicted, and why."""
        found = tuple(
            f"{'Block' if 'blocks' in self.scheme else 'Fold'} {part.number} of {self.parts} "
            f"({part.poses} poses) is not validated: {part.reason}."
            for part in self.failed
        )
        return found if self.blocked is None else (*found, *self.blocked.warnings)

    @property
    def coverage(self) -> Coverage | None:
        """How often the stated regions hold; None where the method states none."""
        if self.inside is None or not (there := np.isfinite(self.inside)).any():
            return None
        return Coverage(LEVEL, float(self.inside[there].mean()), int(there.sum()))

    @property
    def entry(self) -> ValidationEntry:
        """As a document holds it."""
        found = self.accuracy
        turned = None if found is None else found.orientation
        return ValidationEntry(
            dict(self.scheme),
            self.words,
            len(self.poses),
            None if found is None else found.distances,
            self.log_likelihood,
            None if turned is None else turned.distances,
            () if found is None else tuple(one.entry for one in found.by),
            self.parts,
            self.failed,
            self.coverage,
            None if self.blocked is None else self.blocked.entry,
        )

    def added_to(self, document: ResultDocument) -> ResultDocument:
        """The document of the result that was validated, with this."""
        warnings = (*document.warnings, *self.warnings)
        return replace(document, validation=self.entry, warnings=warnings)


class ValidationOptions(FitOptions, SchemeOptions, total=False):
    """The fields of `Fit` and of `Scheme` as keyword arguments."""


def validate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    full: Result | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **options: Unpack[ValidationOptions],
) -> Validation:
    """How well this calibration predicts poses that it has not seen.

    noise, fit: as in `calibrate`, with its keyword arguments; full: the calibration of all poses,
    if it is at hand; executor: who does the refits, this process one by one if it is None, which
    changes no value; progress: called with how many refits are done.

    folds: in how many parts the poses are cut, each left out once (default 10); blocks: in how many
    regions of the joint space, left out one by one besides (default none); hold_out: instead leave
    out this share once; other: instead calibrate on all and predict these readings
    (other_noise: their noise where it is not the same); seed: of the choice; groups: one per pose,
    never split, by default poses with the same driven readings.

    A part whose fit fails is reported (`Validation.failed`), and the others count. Raises
    InputError as `calibrate` does and for a choice that cannot be made, and NoTrustworthyResult
    where every refit fails.
    """
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    asked = Asked.of(fit, options)
    case = Case(mechanism, data, Noise.of(noise), asked.fit)
    return validated(case, full or case.calibrated(), asked.scheme, executor, progress)


def validated(
    case: Case,
    whole: Result,
    scheme: Scheme,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Validation:
    """`validate` for a case whose calibration of all poses is at hand."""
    if scheme.other is not None:
        other = scheme.other
        known = case.noise if scheme.other_noise is None else Noise.of(scheme.other_noise)
        name = other.source.name or "other readings"
        held = held_problem(whole, other, known)
        part = _predicted(whole, held, np.arange(len(other)), whole.covariance)
        words = f"{len(other)} poses of {name}"
        return _pooled(whole, [part], Parts((), {"file": name}, words), other)
    sds = stated_sds(case.noise, case.mechanism, case.data)
    groups = grouped(case.mechanism, case.data, scheme.groups, sds)
    parts = [parts_of(scheme, case.data, groups)]
    if scheme.blocks:
        parts.append(blocks_of(scheme, case.mechanism, case.data, groups))
    begun = _Begun.at(case, whole)
    indices = [index for part in parts for index in part.indices]
    made = gathered(executor, _left_out, begun, indices, progress)
    count = len(parts[0].indices)
    found = _pooled(whole, made[:count], parts[0], case.data)
    if len(parts) == 1:
        return found
    return replace(found, blocked=_pooled(whole, made[count:], parts[1], case.data))


@dataclass(frozen=True, eq=False)
class Asked:
    """What the keyword arguments of `validate` ask for."""

    fit: Fit
    scheme: Scheme

    @classmethod
    def of(cls, fit: Fit | None, options: ValidationOptions) -> Asked:
        """Settings and scheme; keyword arguments override the settings."""
        given: dict[str, Any] = dict(options)
        scheme = {name: given.pop(name) for name in SchemeOptions.__annotations__ if name in given}
        return cls(Fit.of(fit, cast(FitOptions, given)), Scheme(**scheme))


@dataclass(frozen=True)
class _Predicted:
    """Poses that a fit has not seen, n of them, at these positions.

    measured, differences (c, n) [SI]: what is compared, and computed minus measured ones; stated:
    what the fit stated of them, None where it states nothing.
    """

    index: Index
    measured: Array
    differences: Array
    stated: Predictive | None


@dataclass(frozen=True)
class _Failed:
    """Poses at these positions that could not be predicted, and why."""

    index: Index
    reason: str


@dataclass(frozen=True, eq=False)
class Case:
    """A calibration as it was asked for."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    fit: Fit

    def calibrated(self, index: Index | None = None) -> Result:
        """The calibration of these poses, by default of all."""
        data = self.data if index is None else self.data.take(index)
        return calibrate(self.mechanism, data, noise=taken(self.noise, index), fit=self.fit)


@dataclass(frozen=True)
class _Begun:
    """What the fits of all parts share: the calibration, and where that of all poses ended.

    drifts: whether all poses show serial dependence.
    """

    case: Case
    near: Case
    drifts: bool

    @classmethod
    def at(cls, case: Case, whole: Result) -> _Begun:
        """Parameters and learnt sds of the calibration of all poses."""
        noise, learnt = case.noise, whole.estimate
        if learnt is not None and learnt.settled:
            noise = (noise or Noise({})).begun_at(learnt.factors)
        # the mechanism of the calibration has the prior already
        fit = replace(case.fit, start=dict(whole.value), prior=None)
        return cls(case, Case(whole.mechanism, case.data, noise, fit), whole.drifts)

    def calibrated(self, index: Index) -> Result:
        """The calibration of these poses, begun where that of all poses ended."""
        found = self.near.calibrated(index)
        if found.spectrum.rank < len(found.estimated) or not found.status.converged:
            return self.case.calibrated(index)
        return found


def _left_out(begun: _Begun, index: Index) -> _Predicted | _Failed:
    """The poses at these positions, predicted by a fit of the others."""
    case = begun.case
    rest = np.setdiff1d(np.arange(len(case.data)), index)
    with one_blas_thread():
        try:
            found = begun.calibrated(rest)
            if not found.status.converged:
                return _Failed(index, f"the fit did not converge ({found.status.reason})")
            covariance = found.covariance if begun.drifts else found.covariance_if_independent
            held = held_problem(found, case.data.take(index), taken(case.noise, index))
            return _predicted(found, held, index, covariance)
        except (InputError, NoTrustworthyResult) as error:
            return _Failed(index, error.message)


def _predicted(fit: Result, held: Held, index: Index, covariance: Array) -> _Predicted:
    rows = [fit.mechanism.tape.quantities.index(q) for q in fit.mechanism.compared]
    differences = output_differences(held.problem, held.problem.start, held.corrections)
    return _Predicted(
        index, held.problem.readings[rows], differences, predictive(fit, held, covariance)
    )


def _pooled(
    whole: Result,
    made: Sequence[_Predicted | _Failed],
    parts_left: Parts,
    data: Dataset,
) -> Validation:
    mechanism, words = whole.mechanism, parts_left.words
    failed = tuple(
        FailedPart(number, len(part.index), part.reason)
        for number, part in enumerate(made, 1)
        if isinstance(part, _Failed)
    )
    parts = [part for part in made if isinstance(part, _Predicted)]
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
    for part in parts:
        measured[:, part.index] = part.measured
        differences[:, part.index] = part.differences
        if part.stated is not None:
            terms[part.index] = part.stated.log_density
            inside[part.index] = part.stated.inside()
    judged = all(part.stated is not None for part in parts)
    apart = deviations(mechanism, measured, differences)
    off = by_pose(apart)
    predicted = np.unique(np.concatenate([part.index for part in parts]))
    return Validation(
        MappingProxyType(dict(parts_left.stated)),
        words,
        accuracy(apart),
        float(terms[predicted].sum()) if judged else None,
        tuple(data.poses[i] for i in predicted),
        None if off is None else off[predicted],
        terms[predicted] if judged else None,
        len(made),
        failed,
        inside[predicted] if judged else None,
    )


@dataclass(frozen=True, eq=False)
class MethodComparison:
    """Several ways to calibrate, each validated on the very same poses, by name."""

    validations: Mapping[str, Validation]

    def __str__(self) -> str:
        units = [v.accuracy.unit for v in self.validations.values() if v.accuracy is not None]
        entries = {name: found.entry for name, found in self.validations.items()}
        return "\n".join(validation_table(entries, units[0] if units else ""))


def compare_methods(
    mechanism: Mechanism,
    data: Dataset | Any,
    methods: Mapping[str, Mapping[str, Any]],
    **validation: Any,
) -> MethodComparison:
    """Several methods, noises or priors validated on the same folds.

    methods: a name for each, with its keyword arguments of `validate`, such as
    {"robust": {"noise": noise, "loss": "huber"}, "plain": {"noise": noise}}; validation: folds,
    hold_out, other, seed, groups, executor, the same for all.

    Raises InputError as `validate` does, and without any method.
    """
    if not methods:
        raise InputError(
            "no method is given to compare", code="missing-key", remedy="name one or more"
        )
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    found = {name: validate(mechanism, data, **how, **validation) for name, how in methods.items()}
    return MethodComparison(MappingProxyType(found))
