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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.accuracy import ModelEntry
from loopcal.document.plain import known as finite
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import model_table, recommendation
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import Result
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.effects.model import Model, with_only
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from loopcal.statistics.folds import grouped
from loopcal.statistics.validation import Validation, validate

Array = NDArray[np.float64]
GEOMETRIC = "geometric"
"""The model without effects, always among those compared."""
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


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Models compared on the same poses; recommended: the simplest that the data do not refuse.

    result: the calibration of all poses with the recommended model.
    """

    models: tuple[ComparedModel, ...]
    recommended: str
    result: Result

    @property
    def entries(self) -> tuple[ModelEntry, ...]:
        """As a document holds them."""
        return tuple(
            ModelEntry(
                m.name,
                m.effects,
                m.fixed,
                m.parameters,
                m.validation and m.validation.accuracy and m.validation.accuracy.distances,
                m.validation and m.validation.log_likelihood,
                m.behind,
                finite(m.sd),
                m.name == self.recommended,
                m.failed or None,
            )
            for m in self.models
        )

    @property
    def validation(self) -> Validation | None:
        """That of the recommended model."""
        return next(m.validation for m in self.models if m.name == self.recommended)

    @property
    def words(self) -> str:
        """Why this model."""
        return recommendation(self.entries)

    def added_to(self, document: ResultDocument) -> ResultDocument:
        """The document of the result with the recommended model, with this."""
        document = replace(document, models=self.entries)
        return self.validation.added_to(document) if self.validation else document

    def __str__(self) -> str:
        found = self.validation
        unit = found.accuracy.unit if found and found.accuracy else ""
        return "\n".join(model_table(self.entries, unit, found.words if found else ""))


def compare_models(
    mechanism: Mechanism,
    data: Dataset | Any,
    models: Mapping[str, Model],
    *,
    noise: Noise | None = None,
    prior: Prior | None = None,
    method: str = "implicit-loop",
    loss: str = "gaussian",
    start: str | Mapping[str, float] = "auto",
    max_iterations: int = 100,
    **validation: Any,
) -> ModelComparison:
    """Models of one machine validated on the same poses, and the one to take.

    models: by name; "geometric", without effects, is added where it is not among them.
    validation: folds, hold_out, other, seed, groups, executor, progress as in `validate`, the rest
    as in `calibrate`.

    Raises InputError as `validate` does and for models that cannot be, and NoTrustworthyResult
    where no model has a predictive log-likelihood.
    """
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    if not models:
        raise InputError(
            "no model is stated to compare with the geometric one",
            remedy='state one or more: in a project [[compare.model]] with name = "..." and '
            "effects = [...]",
        )
    if GEOMETRIC not in models:
        models = {GEOMETRIC: Model(), **models}
    if prior is not None:
        mechanism = mechanism.with_parameters(prior.apply(mechanism.parameters))
    how: dict[str, Any] = {"noise": noise, "method": method, "loss": loss, "start": start}
    how["max_iterations"] = max_iterations
    machines = {name: with_only(mechanism, model) for name, model in models.items()}
    fits: dict[str, Result] = {}
    found: list[ComparedModel] = []
    for name, model in models.items():
        fit = calibrate(machines[name], data, **how)
        one = ComparedModel(name, model.effects, model.fixed, len(fit.estimated), None)
        fits[name] = fit
        found.append(_validated(one, machines[name], data, fit, how, validation))
    judged = _judged(found, _groups(mechanism, data, validation))
    chosen = recommended(judged)
    return ModelComparison(tuple(judged), chosen, fits[chosen])


def _validated(
    one: ComparedModel,
    machine: Mechanism,
    data: Dataset,
    fit: Result,
    how: Mapping[str, Any],
    validation: Mapping[str, Any],
) -> ComparedModel:
    if not fit.status.converged:
        return replace(one, failed=f"the fit did not converge ({fit.status.reason})")
    try:
        found = validate(machine, data, **how, **validation, full=fit)
    except NoTrustworthyResult as error:
        return replace(one, failed=error.message)
    if found.by_pose is None:
        return replace(one, failed="its predictions have no probability: state sds, or priors")
    return replace(one, validation=found)


def _groups(
    mechanism: Mechanism, data: Dataset, validation: Mapping[str, Any]
) -> Mapping[str, int]:
    """The group of each pose by its id; none where other readings are predicted."""
    if validation.get("other") is not None:
        return {}
    codes = grouped(mechanism, data, validation.get("groups")).tolist()
    return dict(zip(data.poses, codes, strict=True))


def _judged(models: Sequence[ComparedModel], groups: Mapping[str, int]) -> list[ComparedModel]:
    """The models with how far they are behind the best."""
    known = [m.validation for m in models if m.validation is not None]
    if not known:
        raise NoTrustworthyResult(
            "no model could be validated: " + "; ".join(f"{m.name}: {m.failed}" for m in models),
            remedy="calibrate one of them alone and see what its summary says",
        )
    best = max(known, key=_likelihood)
    return [m if m.validation is None else _behind(m, m.validation, best, groups) for m in models]


def _behind(
    model: ComparedModel, own: Validation, best: Validation, groups: Mapping[str, int]
) -> ComparedModel:
    d = _terms(best) - _terms(own)
    if groups:
        codes = np.unique([groups[pose] for pose in own.poses], return_inverse=True)[1]
        d = np.asarray(np.bincount(codes, weights=d), dtype=np.float64)
    sd = math.sqrt(len(d) * float(np.var(d, ddof=1))) if len(d) > 1 else math.inf
    return replace(model, behind=_likelihood(best) - _likelihood(own), sd=sd)


def recommended(models: Sequence[ComparedModel]) -> str:
    """The name of the model with the fewest parameters among those that are not refused."""

    def refused(m: ComparedModel) -> bool:
        return m.behind is None or m.behind > max(LEAST, ERRORS * (m.sd or 0.0))

    return min((m for m in models if not refused(m)), key=lambda m: (m.parameters, m.behind)).name


def _likelihood(validation: Validation) -> float:
    assert validation.log_likelihood is not None
    return validation.log_likelihood


def _terms(validation: Validation) -> Array:
    assert validation.by_pose is not None
    return validation.by_pose
