"""Which model of a machine: geometry alone, or with effects beyond it, as unseen poses judge.

All models are validated on the same folds. What counts is the predictive log-likelihood, whose
difference between two models has a standard error from its scatter over the poses,

    se = sqrt(G var_g(d_g)),   d_g = difference in the group g of poses that stay together

(Vehtari, Gelman and Gabry 2017, practical Bayesian model evaluation, equation 24). The simplest
model that is behind the best by no more than twice that, or by no more than 4, is recommended:
Breiman and others (1984) take one standard error where nothing is lost by a simple model; it is
too small where models are alike, and a difference under 4 is never told apart (Sivula, Magnusson
and Vehtari 2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.accuracy import ModelEntry
from loopcal.document.plain import finite
from loopcal.document.tables import model_table, recommendation
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import FitResult
from loopcal.execution.executor import Executor, Progress
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.effects.effect import Model, with_only
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case
from loopcal.statistics.folds import Scheme, grouped, stated_sds
from loopcal.statistics.validation import Asked, Validation, ValidationOptions, validated

GEOMETRIC = "geometric"
"""The model without effects, always among those compared."""
# Record 0013: Sivula, Magnusson and Vehtari (2020).
ERRORS, LEAST = 2.0, 4.0
"""A model is refused that is behind by more than so many standard errors and by more than this."""


@dataclass(frozen=True, eq=False)
class ComparedModel:
    """One of several models of the same readings, judged by poses that it has not seen.

    effects: those beyond geometry that are switched on; fixed: parameters by names or globs that
    it does not estimate; parameters: how many it does; validation: None where a fit did not
    converge, with the reason in `failed`; behind: by how much its predictive log-likelihood is
    less than the best one's; sd: of that difference, from its scatter over the poses.
    """

    name: str
    effects: tuple[str, ...]
    fixed: tuple[str, ...]
    parameters: int
    validation: Validation | None
    behind: float | None = None
    sd: float | None = None
    failed: str = ""

    def entry(self, *, recommended: bool) -> ModelEntry:
        """As a document holds it; recommended: whether it is the one to take."""
        validation = self.validation
        accuracy = None if validation is None else validation.accuracy
        return ModelEntry(
            self.name,
            self.effects,
            self.fixed,
            self.parameters,
            None if accuracy is None else accuracy.distances,
            None if validation is None else validation.log_likelihood,
            self.behind,
            finite(self.sd),
            recommended,
            self.failed or None,
        )


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Models compared on the same poses; recommended: the simplest that the data do not refuse.

    result: the calibration of all poses with the recommended model.
    """

    models: tuple[ComparedModel, ...]
    recommended: str
    result: FitResult

    @property
    def entries(self) -> tuple[ModelEntry, ...]:
        """As a document holds them."""
        return tuple(m.entry(recommended=m.name == self.recommended) for m in self.models)

    @property
    def validation(self) -> Validation | None:
        """That of the recommended model."""
        return next(m.validation for m in self.models if m.name == self.recommended)

    @property
    def words(self) -> str:
        """Why this model."""
        return recommendation(self.entries)

    def __str__(self) -> str:
        validation = self.validation
        unit = validation.accuracy.unit if validation and validation.accuracy else ""
        return "\n".join(model_table(self.entries, unit, validation.words if validation else ""))


def compare_models(
    mechanism: Mechanism,
    data: Dataset | Any,
    models: Mapping[str, Model],
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **options: Unpack[ValidationOptions],
) -> ModelComparison:
    """Models of one machine validated on the same poses, and the one to take.

    models: by name; "geometric", without effects, is added where it is not among them.
    The rest is as in `validate`, with its keyword arguments. Where folds of a model fail, the
    models are compared on the poses that all of them predict; a model that fails altogether is
    reported with the reason.

    Raises InputError as `validate` does and for models that cannot be, and NoTrustworthyResult
    where no model has a predictive log-likelihood.
    """
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    if not models:
        raise InputError(
            "no model is stated to compare with the geometric one",
            code="missing-key",
            remedy='state one or more: in a project [[compare.model]] with name = "..." and '
            "effects = [...]",
        )
    if GEOMETRIC not in models:
        models = {GEOMETRIC: Model(), **models}
    asked, stated_noise = Asked.of(fit, options), Noise.of(noise)
    mechanism = asked.fit.with_prior(mechanism)
    by_one = asked.fit.changed(method=asked.fit.among(data, stated_noise)[0], prior=None)
    shared = Case(mechanism, data, stated_noise, by_one)
    fits: dict[str, FitResult] = {}
    errors: list[InputError] = []
    compared: list[ComparedModel] = []
    for name, model in models.items():
        case = replace(shared, mechanism=with_only(mechanism, model))
        free = len(case.mechanism.parameters.free)
        one = ComparedModel(name, model.effects, model.fixed, free, None)
        try:
            fits[name] = case.calibrated()
        except InputError as error:
            errors.append(error)
            compared.append(replace(one, failed=error.message))
            continue
        run = partial(validated, case, fits[name], asked.scheme, executor, progress)
        compared.append(_validated(one, fits[name], run))
    if not fits:
        raise errors[0]
    judged = _judged(compared, _groups(shared, asked.scheme))
    chosen = recommended(judged)
    comparison = ModelComparison(tuple(judged), chosen, fits[chosen])
    validation = comparison.validation and comparison.validation.entry
    result = comparison.result.with_parts(models=comparison.entries, validation=validation)
    return replace(comparison, result=result)


def _validated(one: ComparedModel, fit: FitResult, run: Callable[[], Validation]) -> ComparedModel:
    if not fit.status.converged:
        return replace(one, failed=f"the fit did not converge ({fit.status.reason})")
    try:
        validation = run()
    except NoTrustworthyResult as error:
        return replace(one, failed=error.message)
    if validation.by_pose is None:
        return replace(one, failed="its predictions have no probability: state sds, or priors")
    return replace(one, validation=validation)


def _groups(case: Case, scheme: Scheme) -> Mapping[str, int]:
    """The group of each pose by its id; none where other readings are predicted."""
    if scheme.other is not None:
        return {}
    sds = stated_sds(case.noise, case.mechanism, case.data)
    codes = grouped(case.mechanism, case.data, scheme.groups, sds).tolist()
    return dict(zip(case.data.poses, codes, strict=True))


def _judged(models: Sequence[ComparedModel], groups: Mapping[str, int]) -> list[ComparedModel]:
    """The models with how far they are behind the best, on the poses that all of them predict."""
    validations = [m.validation for m in models if m.validation is not None]
    if not validations:
        raise NoTrustworthyResult(
            "no model could be validated: " + "; ".join(f"{m.name}: {m.failed}" for m in models),
            code="not-converged",
            remedy="calibrate one of them alone and read its summary",
        )
    common = set(validations[0].poses).intersection(*(v.poses for v in validations))
    if not common:
        raise NoTrustworthyResult(
            "no pose is predicted by every model, because folds of several models failed: "
            + "; ".join(w for v in validations for w in v.warnings),
            code="not-converged",
            remedy="compare fewer models, or use other folds",
        )
    terms = {m.name: _terms(m.validation, common) for m in models if m.validation is not None}
    best = max(terms.values(), key=lambda pose_terms: float(pose_terms.sum()))
    poses = [pose for pose in validations[0].poses if pose in common]
    codes = [groups[pose] for pose in poses] if groups else range(len(poses))
    index = np.unique([*codes], return_inverse=True)[1]
    return [_behind(m, best, terms.get(m.name), index) for m in models]


def _behind(
    model: ComparedModel, best: Array, terms: Array | None, index: NDArray[np.intp]
) -> ComparedModel:
    if terms is None:
        return model
    d = np.asarray(np.bincount(index, weights=best - terms), dtype=np.float64)
    sd = math.sqrt(len(d) * float(np.var(d, ddof=1))) if len(d) > 1 else math.inf
    return replace(model, behind=float(best.sum() - terms.sum()), sd=sd)


def recommended(models: Sequence[ComparedModel]) -> str:
    """The name of the model with the fewest parameters among those that are not refused."""

    def refused(m: ComparedModel) -> bool:
        return m.behind is None or m.behind > max(LEAST, ERRORS * (m.sd or 0.0))

    return min((m for m in models if not refused(m)), key=lambda m: (m.parameters, m.behind)).name


def _terms(validation: Validation, poses: set[str]) -> Array:
    """The log densities of these poses, in the order of the readings."""
    assert validation.by_pose is not None
    return validation.by_pose[[pose in poses for pose in validation.poses]]
