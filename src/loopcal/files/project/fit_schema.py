"""What a file may say of a fit: its settings, its validation and what is made of it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from loopcal.estimation.fit import MODEL_ERRORS, STARTS
from loopcal.estimation.methods.registry import DEFAULT, METHODS
from loopcal.estimation.solve.loss import LOSSES
from loopcal.files.toml.model import Model, NameOrNumber, OneOf

MethodName = Annotated[str, OneOf(tuple(METHODS))]
StartName = Annotated[str, OneOf(STARTS)]


class SettingsEntry(Model):
    """The settings of a fit, as `loopcal.Fit` has them."""

    method: MethodName = DEFAULT
    loss: Annotated[str, OneOf(LOSSES)] = Field(
        default="gaussian",
        description="huber, student-t: poses that do not fit count less.",
    )
    start: StartName = Field(
        default="auto",
        description="align: the nominal machine is first moved to where the instrument sees it; "
        "auto: that, for a spatial machine whose placement is free and has flat priors.",
    )
    max_iterations: Annotated[int, Field(ge=1)] = 100
    tolerance: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Step, in sds, that counts as converged; default: that of the method.",
    )
    model_error: Annotated[str, OneOf(MODEL_ERRORS)] = Field(
        default="none",
        description="structured: add terms for what the machine model lacks; their sizes are "
        "learnt.",
    )


class ValidationEntry(Model):
    """Which poses take no part in a fit and are predicted by it: one of folds, hold_out, file, and
    blocks beside the first two."""

    folds: Annotated[int, Field(ge=2)] | None = Field(
        default=None, description="So many parts, each left out once."
    )
    blocks: Annotated[int, Field(ge=2)] | None = Field(
        default=None,
        description="So many regions of the joint space, each left out once besides; alone it "
        "comes with 10 folds.",
    )
    hold_out: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="This share is left out, once."
    )
    file: str | None = Field(
        default=None, description="These readings are predicted, in the columns of [data]."
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="Of the choice.")
    group: NameOrNumber | None = Field(
        default=None,
        description="Column of numbers: poses with the same one stay together. Without it those "
        "with the same driven readings do. Alone it leaves out each group, such as a station or a "
        "session, and places the instrument by the readings of that group.",
    )


class FitEntry(SettingsEntry):
    """How to fit."""

    require_identifiable: bool = Field(
        default=False, description="true: end with exit code 4 if a parameter is not determined."
    )
    apply_variance_factor: bool = Field(
        default=False,
        description="true: multiply the covariance by chi-squared per degree of freedom.",
    )
    validation: ValidationEntry | None = Field(
        default=None,
        description="Accuracy on poses not used for the fit.",
        examples=[{"folds": 10, "blocks": 5}, {"hold_out": 0.3}, {"file": "other.csv"}],
    )
    profile: list[str] = Field(
        default=[],
        description="Parameters, by name or glob, that get a profile likelihood interval.",
        examples=[["l2", "phi*"]],
    )
