"""How to fit: the settings that every calibration takes, checked where they are stated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypedDict, Unpack

from loopcal.errors import InputError, nearest
from loopcal.estimation.methods.method import Method
from loopcal.estimation.methods.registry import DEFAULT, PLAIN, method_named, names_where
from loopcal.estimation.solve.loss import Loss, loss_named
from loopcal.estimation.solve.status import MOST_ITERATIONS
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior, PriorLike

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
    (`loopcal.estimation.model_error`).

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
            raise InputError(
                f"there is no start {start!r}", code="unknown-name", remedy=nearest(start, STARTS)
            )
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
            raise InputError(
                f"there is no model_error {model_error!r}",
                code="unknown-name",
                remedy=nearest(model_error, MODEL_ERRORS),
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
