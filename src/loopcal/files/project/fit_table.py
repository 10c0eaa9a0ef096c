"""The [fit] table of a project: how to fit, its validation, and what is made of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from loopcal.errors import InputError
from loopcal.estimation.fit import MODEL_ERRORS, STARTS, Fit
from loopcal.estimation.methods.registry import DEFAULT, METHODS
from loopcal.estimation.solve.loss import LOSSES
from loopcal.estimation.solve.solution import MOST_ITERATIONS
from loopcal.files.project.names import PARAMETER
from loopcal.keys import Key
from loopcal.lazy import cached_property

Method = Annotated[
    str,
    Key(
        "How to estimate. auto: the other methods compete, with a model error and without, and "
        "poses not used choose.",
        choices=tuple(METHODS),
    ),
]
Start = Annotated[
    str,
    Key(
        "nominal: at the nominal machine; align: that machine is first moved to where the "
        "instrument sees it; auto: that, for a spatial machine whose placement is free and has "
        "flat priors, and for one in the plane that is turned by more than 45 degrees.",
        choices=STARTS,
    ),
]


@dataclass(frozen=True)
class Settings:
    """The settings of a fit, as `loopcal.Fit` has them.

    Raises InputError for settings that do not go together.
    """

    method: Method = DEFAULT
    loss: Annotated[
        str,
        Key(
            "huber, student-t: poses that do not fit count less; for implicit-loop and reweighted.",
            choices=LOSSES,
        ),
    ] = "gaussian"
    start: Start = "auto"
    max_iterations: Annotated[
        int, Key("Limit of one fit, which ends earlier when it converges.", low=1)
    ] = MOST_ITERATIONS
    tolerance: Annotated[
        float | None,
        Key("Step, in sds, that counts as converged; default: that of the method.", positive=True),
    ] = None
    model_error: Annotated[
        str,
        Key(
            "structured: add terms for what the machine model lacks; their sizes are learnt.",
            choices=MODEL_ERRORS,
        ),
    ] = "none"

    def __post_init__(self) -> None:
        # Settings that do not go together are refused here, where the file and key are known.
        _ = self.settings

    @cached_property
    def settings(self) -> Fit:
        """As `calibrate` takes them."""
        return Fit(
            method=self.method,
            loss=self.loss,
            start=self.start,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            model_error=self.model_error,
        )


@dataclass(frozen=True)
class Validation:
    """Which poses take no part in a fit and are predicted by it.

    One of folds, hold_out and file is stated, blocks beside the first two; blocks alone come with
    10 folds; a group alone leaves out whole groups.

    Raises InputError unless exactly one way is stated.
    """

    folds: Annotated[int | None, Key("So many parts, each left out once.", low=2)] = None
    blocks: Annotated[
        int | None,
        Key(
            "So many regions of the joint space, each left out once besides; alone it comes with "
            "10 folds.",
            low=2,
        ),
    ] = None
    hold_out: Annotated[
        float | None, Key("This share is left out, once.", positive=True, below=1)
    ] = None
    file: Annotated[str | None, Key("These readings are predicted, in the columns of [data].")] = (
        None
    )
    seed: Annotated[int, Key("Of the choice.", low=0)] = 0
    group: Annotated[
        str | int | None,
        Key(
            "Column of numbers: poses with the same one stay together. Without it those with the "
            "same driven readings do. Alone it leaves out each group, such as a station or a "
            "session, and places the instrument by the readings of that group."
        ),
    ] = None

    def __post_init__(self) -> None:
        stated = [k for k in ("folds", "hold_out", "file") if getattr(self, k) is not None]
        if not stated and self.blocks is not None:
            object.__setattr__(self, "folds", 10)
        elif self.file is not None and self.blocks is not None:
            raise InputError(
                "the validation states blocks and file, but another file has no regions to leave "
                "out",
                code="conflicting-keys",
                remedy='give blocks = 5 with folds = 10, or file = "other.csv" alone',
            )
        elif len(stated) != 1 and (stated or self.group is None):
            raise InputError(
                f"the validation states {' and '.join(stated) or 'no way to leave poses out'}",
                code="missing-key",
                remedy='give one of folds = 10, hold_out = 0.3, file = "other.csv", '
                'group = "column"',
            )


@dataclass(frozen=True)
class FitTable(Settings):
    """How to fit, and what is made of the fit."""

    require_identifiable: Annotated[
        bool, Key("true: end with exit code 4 if a parameter is not determined.")
    ] = False
    apply_variance_factor: Annotated[
        bool, Key("true: multiply the covariance by chi-squared per degree of freedom.")
    ] = False
    validation: Annotated[
        Validation | None,
        Key("Accuracy on poses not used for the fit.", example={"folds": 10, "blocks": 5}),
    ] = None
    profile: Annotated[
        tuple[str, ...],
        Key(
            "Parameters, by name or glob, that get a profile likelihood interval.",
            names=PARAMETER,
            example=["l2", "phi*"],
        ),
    ] = ()
