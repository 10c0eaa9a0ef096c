"""The public validation: how well a calibration predicts poses that it has not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Unpack

from loopcal.document.tables import validation_table
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import FitResult
from loopcal.execution.executor import Executor, Progress
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case
from loopcal.statistics.choice import choose
from loopcal.statistics.validation import Asked, Validation, ValidationOptions, validated


def validate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    full: FitResult | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **options: Unpack[ValidationOptions],
) -> Validation:
    """How well this calibration predicts poses that it has not seen.

    noise, fit: as in `calibrate`, with its keyword arguments; full: the calibration of all poses,
    if it is at hand; executor: who does the refits, by default the cores of this process, which
    changes no value; progress: called with how many refits are done.

    folds: in how many parts the poses are cut, each left out once (default 10); blocks: in how many
    regions of the joint space, left out one by one besides (default none); hold_out: instead leave
    out this share once; other: instead calibrate on all and predict these readings
    (other_noise: their noise where it is not the same); seed: of the choice; groups: one per pose,
    never split, by default poses with the same driven readings; place_anew: instead leave out each
    of these groups, such as a station or a session, and place the instrument by its own readings.

    The method "auto" chooses by these very poses; its validation is that of the chosen candidate.

    A part whose fit fails is reported (`Validation.failed`), and the others count. Raises
    InputError as `calibrate` does and for a choice that cannot be made, and NoTrustworthyResult
    where every refit fails.
    """
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    asked = Asked.of(fit, options)
    case = Case(mechanism, data, Noise.of(noise), asked.fit)
    if not asked.fit.method.choice:
        return validated(case, full or case.calibrated(), asked.scheme, executor, progress)
    validation = choose(case, asked.scheme, executor, progress).validation
    if validation is None:
        raise NoTrustworthyResult(
            "no candidate of the choice could be validated",
            code="not-converged",
            remedy="calibrate by a stated method, and read its summary",
        )
    return validation


@dataclass(frozen=True, eq=False)
class MethodComparison:
    """Several ways to calibrate, each validated on the very same poses, by name."""

    validations: Mapping[str, Validation]

    def __str__(self) -> str:
        units = [v.accuracy.unit for v in self.validations.values() if v.accuracy is not None]
        entries = {name: validation.entry for name, validation in self.validations.items()}
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
    validations = {
        name: validate(mechanism, data, **how, **validation) for name, how in methods.items()
    }
    return MethodComparison(MappingProxyType(validations))
