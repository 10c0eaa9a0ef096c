"""What a file says of a fit, resolved: the settings, and what is made of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from loopcal.errors import InputError
from loopcal.estimation.fit import Fit
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism

if TYPE_CHECKING:
    from loopcal.files.project.fit_schema import FitEntry, SettingsEntry, ValidationEntry


@dataclass(frozen=True)
class ValidationSpec:
    """One of folds, hold_out and file is stated, blocks beside the first two; group: the column of
    numbers that name groups, which by itself leaves out whole groups."""

    folds: int | None = None
    blocks: int | None = None
    hold_out: float | None = None
    file: str | None = None
    seed: int = 0
    group: str | int | None = None


@dataclass(frozen=True)
class FitSpec:
    """How to fit, and what to make of the fit.

    settings: see `calibrate`; require_identifiable: else the result is not trusted; validation:
    None where none is asked for; profile: parameters that get a profile interval.
    """

    settings: Fit
    require_identifiable: bool = False
    apply_variance_factor: bool = False
    validation: ValidationSpec | None = None
    profile: tuple[str, ...] = ()


def fit_spec(entry: FitEntry, mechanism: Mechanism, place: Place) -> FitSpec:
    """The fit that a project asks for.

    Raises InputError for settings that do not go together, and for a profile of no parameter.
    """
    for pattern in entry.profile:
        try:
            mechanism.parameters.matching(pattern)
        except InputError as error:
            raise error.at(str(place.at("profile"))) from None
    return FitSpec(
        fit_of(entry, place),
        entry.require_identifiable,
        entry.apply_variance_factor,
        validation_spec(entry.validation, place.at("validation")),
        tuple(entry.profile),
    )


def validation_spec(entry: ValidationEntry | None, place: Place) -> ValidationSpec | None:
    """The validation asked for.

    Raises InputError unless exactly one way is stated.
    """
    if entry is None:
        return None
    stated = [k for k in ("folds", "hold_out", "file") if getattr(entry, k) is not None]
    if not stated and entry.blocks is not None:
        return ValidationSpec(**(entry.model_dump() | {"folds": 10}))
    if not stated and entry.group is not None:
        return ValidationSpec(**entry.model_dump())
    if entry.file is not None and entry.blocks is not None:
        raise InputError(
            "the validation states blocks and file, but another file has no regions to leave out",
            code="conflicting-keys",
            place=str(place),
            remedy='give blocks = 5 with folds = 10, or file = "other.csv" alone',
        )
    if len(stated) != 1:
        raise InputError(
            f"the validation states {' and '.join(stated) or 'no way to leave poses out'}",
            code="missing-key",
            place=str(place),
            remedy='give one of folds = 10, hold_out = 0.3, file = "other.csv", group = "column"',
        )
    return ValidationSpec(**entry.model_dump())


def fit_of(entry: SettingsEntry, place: Place) -> Fit:
    """The settings of a fit.

    Raises InputError for settings that do not go together.
    """
    try:
        return Fit(
            method=entry.method,
            loss=entry.loss,
            start=entry.start,
            max_iterations=entry.max_iterations,
            tolerance=entry.tolerance,
            model_error=entry.model_error,
        )
    except InputError as error:
        raise error.at(str(place)) from None
