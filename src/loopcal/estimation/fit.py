"""How to fit: the settings that every calibration takes, checked where they are stated.

Model error as part of a fit: the terms that a mechanism gets, and what its noise is then.

Sensors whose sds are stated keep them; a learnt white error of the model joins them. Least squares
states no sds: then the readings of instruments carry one learnt sd in each unit, and all other
readings stay exact, e ~ N(0, sigma^2 I).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

from loopcal.errors import InputError, unknown_name
from loopcal.estimation.methods.method import Method
from loopcal.estimation.methods.registry import DEFAULT, PLAIN, method_named, names_where
from loopcal.estimation.solve.loss import Loss, loss_named
from loopcal.estimation.solve.solution import MOST_ITERATIONS
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior, PriorLike
from loopcal.mechanisms.structure.smooth import vectors_for
from loopcal.mechanisms.structure.structured import structured, without

if TYPE_CHECKING:
    from loopcal.measurements.dataset import Dataset
    from loopcal.mechanisms.mechanism import Mechanism


Start = str | Mapping[str, float]
STARTS = ("auto", "align", "nominal")
MODEL_ERRORS = ("none", "structured")


class FitOptions(TypedDict, total=False):
    """The fields of `Fit` as keyword arguments."""

    method: str | Method
    loss: str
    start: Start
    prior: PriorLike | None
    max_iterations: int
    tolerance: float | None
    model_error: str


@dataclass(frozen=True, init=False)
class Fit:
    """The settings of a fit.

    method: its name, see `loopcal.estimation.methods`; loss: "gaussian", "huber" or "student-t";
    start: "nominal", "align", "auto", or parameter values [SI] by name; prior: sds of the
    parameters, by default those of the mechanism; max_iterations: of one fit, at most; tolerance:
    the step [sds] that counts as converged, None is the method's own; model_error: "none", or
    "structured", which adds terms for what the machine model lacks, their sizes learnt
    (`loopcal.estimation.fit`).

    >>> Fit(method="reweighted", loss="huber").method.label
    'reweighted least squares (readings weighted by their propagated noise)'

    Raises InputError for settings that are unknown or do not go together.
    """

    method: Method
    loss: str
    start: Start
    prior: Prior | None
    max_iterations: int
    tolerance: float | None
    model_error: str

    def __init__(
        self,
        *,
        method: str | Method = DEFAULT,
        loss: str = "gaussian",
        start: Start = "auto",
        prior: PriorLike | None = None,
        max_iterations: int = MOST_ITERATIONS,
        tolerance: float | None = None,
        model_error: str = "none",
    ) -> None:
        chosen = method if isinstance(method, Method) else method_named(method)
        if loss_named(loss) is not None and not chosen.robust:
            robust_methods = " or ".join(f'"{name}"' for name in names_where("robust"))
            raise InputError(
                f"the method {chosen.name!r} cannot use the loss {loss!r}: it does not use the "
                f"sds of the readings",
                code="unsupported",
                remedy=f"use method = {robust_methods} with the sds of the readings",
            )
        if isinstance(start, str) and start not in STARTS:
            raise unknown_name(f"there is no start {start!r}", start, STARTS)
        if isinstance(max_iterations, bool) or not max_iterations >= 0:
            raise InputError(
                f"max_iterations is {max_iterations!r}",
                code="invalid-value",
                remedy="give a whole number, 0 or more",
            )
        if tolerance is not None and not 0.0 < tolerance < math.inf:
            raise InputError(
                f"the tolerance is {tolerance!r}",
                code="invalid-value",
                remedy="give a number above zero, say 1e-8",
            )
        if model_error not in MODEL_ERRORS:
            raise unknown_name(
                f"there is no model_error {model_error!r}", model_error, MODEL_ERRORS
            )
        values = {
            "method": chosen,
            "loss": loss,
            "start": start if isinstance(start, str) else dict(start),
            "prior": Prior.of(prior),
            "max_iterations": max_iterations,
            "tolerance": tolerance,
            "model_error": model_error,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, fit: Fit | None, options: FitOptions) -> Fit:
        """The settings given as one value, as keyword arguments, or both: these then win."""
        settings = fit or cls()
        return settings.changed(**options) if options else settings

    def changed(self, **options: Unpack[FitOptions]) -> Fit:
        """These settings with others in place of some."""
        every: FitOptions = {
            "method": self.method,
            "loss": self.loss,
            "start": self.start,
            "prior": self.prior,
            "max_iterations": self.max_iterations,
            "tolerance": self.tolerance,
            "model_error": self.model_error,
            **options,
        }
        return Fit(**every)

    def among(self, data: Dataset, noise: Noise | None) -> tuple[Method, ...]:
        """The methods that its own chooses among and that these readings allow; itself if none.

        Without any sd only those that take the readings as exact; under a loss only those that
        have one.
        """
        stated = bool(data.sds) or (noise is not None and bool(noise.entries or noise.estimate))
        lossless = self.robust_loss is None
        return tuple(
            m
            for m in self.method.choice or (self.method,)
            if not self.method.choice or ((stated or m.exact) and (lossless or m.robust))
        )

    @property
    def solver(self) -> Method:
        """The method whose fit is made: the implicit loop where least squares learns model error.

        Only readings of instruments are uncertain then, all alike.
        """
        learns = self.method.exact and self.model_error != "none"
        return method_named(PLAIN) if learns else self.method

    @property
    def label(self) -> str:
        """The method in words, with the model error where it has one."""
        if self.model_error == "none":
            return self.method.label
        return f"{self.method.label.split(' (')[0]} with structured model error"

    @property
    def robust_loss(self) -> Loss | None:
        """The loss, None for the gaussian one, which needs no weights."""
        return loss_named(self.loss)

    def with_prior(self, mechanism: Mechanism) -> Mechanism:
        """The mechanism with the prior sds and terms of these settings."""
        return mechanism if self.prior is None else self.prior.apply(mechanism)


# Chosen, not derived: the usual size; a start, from which sds are learnt.
BEGIN = 1e-4
"""Learnt sds begin here [SI]: 0.1 mm, 0.1 mrad."""


def used_noise(fit: Fit, mechanism: Mechanism, data: Dataset, noise: Noise | None) -> Noise | None:
    """The noise that a fit uses; None where every reading is exact and no sd is learnt.

    Raises InputError where least squares with model error meets a loop without instrument.
    """
    if fit.solver.exact:
        return None
    if fit.model_error == "none":
        return noise
    if fit.method.exact:
        return instrument_noise(mechanism, data)
    if noise is not None and _isotropic(mechanism) and MODEL not in noise.entries:
        return noise.with_learnt(MODEL, BEGIN)
    return noise


def weighed(fit: Fit, data: Dataset) -> Dataset:
    """The data without the sds that came with them, where a fit learns its own weights."""
    return replace(data, sds={}) if fit.method.exact else data


def modelled(fit: Fit, mechanism: Mechanism, data: Dataset, poses: int | None = None) -> Mechanism:
    """The mechanism with the terms for its model error that a fit of these data asks for.

    poses: how many there are in all, if these are not all. A mechanism that is structured already
    stays as it is. Where joints of one arm are unread while another is looked at, nothing says how
    the joints that carry both give way.
    """
    if fit.model_error == "none" or mechanism.structure is not None:
        return mechanism
    made = structured(mechanism, discrepancy=vectors_for(len(data) if poses is None else poses))
    sag = None if made.structure is None else made.structure.sag
    gaps = any(np.isnan(data.readings[q]).any() for q in mechanism.joints if q in data.readings)
    return without(mechanism, made, (), sag.shared) if sag and sag.shared and gaps else made


def _isotropic(mechanism: Mechanism) -> bool:
    """Whether one sd can serve all outputs, or all loops without outputs."""
    return len({mechanism.quantities[q] for q in mechanism.outputs}) <= 1


def instrument_noise(mechanism: Mechanism, data: Dataset) -> Noise:
    """All readings exact but those of instruments, which have one learnt sd in each unit.

    Raises InputError for a loop without any of these.
    """
    entries: dict[str, float] = {}
    groups: dict[tuple[str, str], list[str]] = {}
    forms = {q: f.form for f in mechanism.families if f.form != "closure" for q in f.readings}
    for name, unit in mechanism.quantities.items():
        read = name in mechanism.implied or np.isfinite(data.readings.get(name, np.nan)).any()
        if not read:
            entries[name] = math.inf
        elif name in forms or name in mechanism.outputs:
            entries[name] = BEGIN
            groups.setdefault((forms.get(name, ""), unit), []).append(name)
        else:
            entries[name] = 0.0
    learnt = {tuple(names): "group" for names in groups.values()}
    if not groups:
        return Noise({**entries, MODEL: BEGIN}, estimate={MODEL: "group"})
    noisy = {name for names in groups.values() for name in names}
    noisy |= {name for name, sd in entries.items() if math.isinf(sd)}
    for loop, names in zip(mechanism.tape.loops, mechanism.tape.depends_on(), strict=True):
        if noisy.isdisjoint(names):
            raise InputError(
                f"the loop {loop!r} has no reading of an instrument, so least squares cannot weigh "
                "its model error",
                code="unsupported",
                remedy="state the sds of the readings ([noise]) and use method = "
                '"implicit-loop", or set model_error = "none"',
            )
    return Noise(entries, estimate=learnt)
