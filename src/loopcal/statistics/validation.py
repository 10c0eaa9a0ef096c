"""Validation without truth: poses that took no part in a fit, predicted by it.

Each part of the data is left out once, the rest is calibrated anew by the same method (its sds
estimated anew, where they are estimated at all), and the outputs of the poses left out are
computed from their other readings. Stone (1974), cross-validatory choice and assessment of
statistical predictions. The refits begin at the solution of all poses, which saves iterations
and gives nothing away: the optimum does not depend on where the search began. Where a part
leaves a direction undetermined, it would; there the refit begins where the first fit did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.accuracy import ValidationEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import validation_table
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import Accuracy, accuracy, by_pose, deviations
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.result import Result
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.execution.executor import Executor, Progress, gathered
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from loopcal.statistics.folds import Index, grouped, held_out
from loopcal.statistics.folds import folds as in_folds
from loopcal.statistics.predictive import held_problem, log_densities, taken

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Validation:
    """How well poses were predicted that took no part in the fit.

    scheme: what was left out, as asked; words: the same for the reader; accuracy: of the outputs
    computed from the other readings, over all poses left out, None where no pose has both;
    log_likelihood: sum over these poses of log N(misclosure; 0, W + D Cov_p D^T) in the units of
    the loop equations, None where the method has no distribution for it; by_pose: (N,) its
    terms, distances: (N,) between computed and measured outputs, both in the order of `poses`.
    """

    scheme: Mapping[str, Any]
    words: str
    accuracy: Accuracy | None
    log_likelihood: float | None
    poses: tuple[str, ...] = ()
    distances: Array | None = None
    by_pose: Array | None = None

    @property
    def entry(self) -> ValidationEntry:
        """As a document holds it."""
        found = self.accuracy
        return ValidationEntry(
            dict(self.scheme),
            self.words,
            len(self.poses),
            found and found.distances,
            self.log_likelihood,
            found and found.orientation and found.orientation.distances,
            tuple(one.entry for one in found.by) if found else (),
        )

    def added_to(self, document: ResultDocument) -> ResultDocument:
        """The document of the result that was validated, with this."""
        return replace(document, validation=self.entry)


def validate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: Noise | None = None,
    prior: Prior | None = None,
    method: str = "implicit-loop",
    loss: str = "gaussian",
    start: str | Mapping[str, float] = "auto",
    max_iterations: int = 100,
    folds: int = 10,
    hold_out: float | None = None,
    other: Dataset | None = None,
    other_noise: Noise | None = None,
    seed: int = 0,
    groups: Sequence[object] | None = None,
    full: Result | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Validation:
    """How well this calibration predicts poses that it has not seen.

    folds: in how many parts the poses are cut, each left out once; hold_out: instead leave out
    this share once; other: instead calibrate on all and predict these readings (other_noise:
    their noise where it is not the same). seed: of the choice. groups: one per pose, never split;
    by default poses with the same driven readings. full: the calibration of all poses, if it is
    at hand. executor: who does the refits, this process one by one if it is None; it changes no
    value. progress: called with how many refits are done. The rest is as in `calibrate`.

    Raises InputError as `calibrate` does and for a choice that cannot be made, and
    NoTrustworthyResult where a refit does not converge.
    """
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    given = _Given(mechanism, data, noise, prior, method, loss, start, max_iterations)
    whole = full or given.fit(None)
    if other is not None:
        known = noise if other_noise is None else other_noise
        scheme: dict[str, Any] = {"file": other.source.name or "other readings"}
        part = _predicted(whole, other, known, np.arange(len(other)))
        return _pooled(whole, [part], scheme, f"{len(other)} poses of {scheme['file']}", other)
    chosen = grouped(mechanism, data, groups)
    if hold_out is not None:
        parts: tuple[Index, ...] = (held_out(chosen, hold_out, seed),)
        scheme = {"hold_out": hold_out, "seed": seed}
        words = f"{len(parts[0])} of {len(data)} poses held out"
    else:
        parts = in_folds(chosen, folds, seed)
        scheme = {"folds": folds, "seed": seed}
        words = f"{folds} folds of {len(data)} poses"
    different = len(np.unique(chosen))
    if different < len(data):
        scheme["groups"] = different
        words += f", {different} of them different"
    begun = _Begun(given, whole.mechanism, dict(whole.value))
    made = gathered(executor, _left_out, begun, parts, progress)
    return _pooled(whole, made, scheme, words, data)


@dataclass(frozen=True)
class _Predicted:
    """Poses that a fit has not seen, n of them, at these positions.

    measured, differences (c, n) [SI]: what is compared, and computed minus measured ones; terms
    (n,): their log densities, None where there are none.
    """

    index: Index
    measured: Array
    differences: Array
    terms: Array | None


@dataclass(frozen=True)
class _Given:
    """A calibration as it was asked for."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    prior: Prior | None
    method: str
    loss: str
    start: str | Mapping[str, float]
    max_iterations: int

    def fit(self, index: Index | None) -> Result:
        """The calibration of these poses, as asked for."""
        data = self.data if index is None else self.data.take(index)
        return calibrate(
            self.mechanism,
            data,
            noise=taken(self.noise, index),
            prior=self.prior,
            method=self.method,
            loss=self.loss,
            start=self.start,
            max_iterations=self.max_iterations,
        )


@dataclass(frozen=True)
class _Begun:
    """What the fits of all parts share: the calibration, and where that of all poses ended."""

    given: _Given
    mechanism: Mechanism
    value: Mapping[str, float]


def _left_out(begun: _Begun, index: Index) -> _Predicted:
    """The poses at these positions, predicted by a fit of the others."""
    given = begun.given
    rest = np.setdiff1d(np.arange(len(given.data)), index)
    with one_blas_thread():
        found = calibrate(
            begun.mechanism,
            given.data.take(rest),
            noise=taken(given.noise, rest),
            method=given.method,
            loss=given.loss,
            start=begun.value,
            max_iterations=given.max_iterations,
        )
        if found.spectrum.rank < len(found.estimated) or not found.status.converged:
            found = given.fit(rest)
        if not found.status.converged:
            raise NoTrustworthyResult(
                f"the fit without {len(index)} of {len(given.data)} poses did not converge "
                f"({found.status.reason}), so they cannot be predicted",
                remedy="use fewer parts, or look at what the summary says of the fit of all poses",
            )
        return _predicted(found, given.data.take(index), taken(given.noise, index), index)


def _predicted(fit: Result, data: Dataset, noise: Noise | None, index: Index) -> _Predicted:
    held = held_problem(fit, data, noise)
    rows = [fit.mechanism.tape.quantities.index(q) for q in fit.mechanism.compared]
    differences = output_differences(held.problem, held.problem.start, held.corrections)
    return _Predicted(index, held.problem.readings[rows], differences, log_densities(fit, held))


def _pooled(
    whole: Result,
    parts: Sequence[_Predicted],
    scheme: Mapping[str, Any],
    words: str,
    data: Dataset,
) -> Validation:
    mechanism = whole.mechanism
    measured, differences = np.full((2, len(mechanism.compared), len(data)), np.nan)
    terms: Array | None = np.full(len(data), np.nan)
    for part in parts:
        measured[:, part.index] = part.measured
        differences[:, part.index] = part.differences
        if part.terms is None or terms is None:
            terms = None
        else:
            terms[part.index] = part.terms
    apart = deviations(mechanism, measured, differences)
    off = by_pose(apart)
    predicted = np.unique(np.concatenate([part.index for part in parts]))
    return Validation(
        MappingProxyType(dict(scheme)),
        words,
        accuracy(apart),
        None if terms is None else float(terms[predicted].sum()),
        tuple(data.poses[i] for i in predicted),
        None if off is None else off[predicted],
        None if terms is None else terms[predicted],
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

    methods: a name for each, with what `validate` shall take for it, such as
    {"basic": {"method": "least-squares"}, "new": {"noise": noise}}; validation: folds, hold_out,
    other, seed, groups, executor, the same for all.

    Raises InputError as `validate` does, and without any method.
    """
    if not methods:
        raise InputError("no method is given to compare", remedy="name one or more")
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    found = {name: validate(mechanism, data, **how, **validation) for name, how in methods.items()}
    return MethodComparison(MappingProxyType(found))
