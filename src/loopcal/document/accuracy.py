"""How far computed outputs are from measured ones: over all instruments, and by instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from loopcal.document.plain import Count, Probability, Size


@dataclass(frozen=True)
class Distances:
    """Distances between computed and measured outputs over the poses that have both."""

    mean: Size
    rms: Size
    p95: Size
    """95 % of the poses are at most so far off."""
    max: Size
    poses: Count | None = None
    """How many distances these are; null: written by an earlier version."""


@dataclass(frozen=True)
class Deviation:
    """Distances before and after; of orientations the angle of the rotation between the two."""

    unit: str
    before: Distances
    """With the nominal parameters."""
    after: Distances
    """With the calibrated parameters."""


@dataclass(frozen=True)
class InstrumentDeviation:
    """The accuracy as one instrument sees it."""

    instrument: str
    station: str | None
    """Where it stands; null: in the machine's own base, or nothing says so."""
    position: Deviation | None
    orientation: Deviation | None


@dataclass(frozen=True)
class PixelSize:
    """How large a pixel of a camera is at the board that it sees."""

    instrument: str
    size: Size
    """Root mean square over all corners [m]."""


@dataclass(frozen=True)
class BoardPlace:
    """Where images put the board of a pose, less where the machine puts it [m].

    By the shift of the board that explains the pixels of the pose best, turned as the machine turns
    it.
    """

    instrument: str | None
    """The camera; null: all cameras of a pose together."""
    position: Distances | None
    """In space; null: no image says how far away its board is."""
    across: Size
    """Rms across the line of sight."""
    along: Size | None
    """Rms along it."""
    noise_across: Size | None
    """What the noise of corners alone would make of `across`; null: its sd is not known."""
    noise_along: Size | None
    """The same of `along`."""


@dataclass(frozen=True)
class AccuracyEntry:
    """Computed minus measured outputs; the readings it is computed from are not corrected.

    before, after: the position, over all instruments. Where no instrument sees one, the
    orientation stands there.
    """

    unit: str
    before: Distances
    """With the nominal parameters."""
    after: Distances
    """With the calibrated parameters."""
    orientation: Deviation | None = None
    """Null where no orientation is measured, or nothing else is."""
    by: tuple[InstrumentDeviation, ...] = ()
    nominal: Distances | None = None
    """With the drawing's parameters, placement and mounting fitted; null: not computed."""
    noise_floor: Size | None = None
    """Expected rms from the noise of the readings alone, with the right parameters; null: unknown,
    for no sds are stated or learnt."""
    pixels: tuple[PixelSize, ...] = ()
    """How large a pixel of each camera is at its board."""
    places: tuple[BoardPlace, ...] = ()
    """Of the boards that cameras see, with the calibrated parameters; all cameras together last."""


@dataclass(frozen=True)
class InstrumentDistances:
    """Distances on poses not used, as one instrument sees them, in the units of `accuracy.by`."""

    instrument: str
    station: str | None
    position: Distances | None
    orientation: Distances | None


@dataclass(frozen=True)
class FailedPart:
    """A part of a validation that could not be predicted."""

    number: Count
    """Which of the parts, from 1."""
    poses: Count
    """How many poses it has."""
    reason: str


@dataclass(frozen=True)
class Coverage:
    """How often the stated regions hold on poses not used."""

    level: Probability
    """Stated probability of each region."""
    share: Probability
    """Share of the poses whose measured point lies in its region; of one pose that was repeated,
    the share of its repeats."""
    poses: Count
    """How many different poses could be tested."""


@dataclass(frozen=True)
class ValidationEntry:
    """How well poses were predicted that took no part in the fit."""

    scheme: Mapping[str, Any]
    """What was left out, as the project asks for it."""
    words: str
    poses: Count
    """Poses that were predicted."""
    accuracy: Distances | None
    """In the unit of `accuracy`; null: no outputs."""
    log_likelihood: float | None
    """Predictive, summed over the poses; null where the method has none, or a part."""
    orientation: Distances | None = None
    """Angles [rad] between computed and measured orientations; null: none, or nothing else is."""
    by: tuple[InstrumentDistances, ...] = ()
    parts: Count = 1
    """How many parts were to be predicted."""
    failed: tuple[FailedPart, ...] = ()
    """Those whose fit failed; they do not count."""
    coverage: Coverage | None = None
    """Null: the method states no regions."""
    places: tuple[BoardPlace, ...] = ()
    """Of the boards that cameras see, all cameras together last."""
    blocked: ValidationEntry | None = None
    """The same for regions of the joint space left out one by one; null: not asked for."""
    images: ValidationEntry | None = None
    """The same for regions of the image; null: no cameras, or too few images."""
    silent: tuple[FailedPart, ...] = ()
    """Parts whose fit states no regions: `coverage` is that of the others."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which parts could not be predicted, and why."""
        part_named = "Block" if "blocks" in self.scheme else "Fold"
        part_named = "Image region" if "of" in self.scheme else part_named
        sentences = tuple(
            f"{part_named} {part.number} of {self.parts} ({part.poses} poses) {lacks}: "
            f"{part.reason}."
            for parts, lacks in ((self.failed, "is not validated"), (self.silent, "has no region"))
            for part in parts
        )
        others = (one.warnings for one in (self.blocked, self.images) if one is not None)
        return (*sentences, *(words for one in others for words in one))


@dataclass(frozen=True)
class ModelEntry:
    """One of the models that were compared on the same poses, none of them used for its fit."""

    name: str
    effects: tuple[str, ...]
    """Effects beyond geometry that were switched on."""
    fixed: tuple[str, ...]
    """Parameters that it did not estimate, names or globs."""
    parameters: Count
    """Number of estimated parameters."""
    accuracy: Distances | None
    log_likelihood: float | None
    behind: Size | None
    """By how much log_likelihood is less than that of the best model."""
    sd_of_behind: Size | None
    """Standard error of it, from its scatter by pose."""
    recommended: bool
    """This document is the calibration with this model."""
    failed: str | None
    """Why it could not be judged."""
