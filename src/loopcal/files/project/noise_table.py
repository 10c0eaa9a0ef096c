"""Noise as project files state it, turned into SI; covariances by pose wait for their columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, placed
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.keys import Key, Made
from loopcal.measurements.datasheet import (
    DatasheetSd,
    Tracker,
    accuracy_unit,
    encoder_sd,
    rounding_sd,
)
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit

NOISE = Key(
    "By quantity, glob, the joined names of all outputs, or several of these with commas; later "
    "lines win.",
    example={"theta_*": {"sd": 5e-5, "unit": "rad"}, "xyz": {"sd": 10, "unit": "um"}},
)


@dataclass(frozen=True)
class StatedNoise:
    """How uncertain readings are: an sd, or a covariance of several quantities together.

    Numbers are as they are stated: what they are of decides how they are converted.
    """

    sd: Annotated[
        float | None, Key("0: exact, never corrected; inf: not measured.", sd=True, alone=True)
    ] = None
    covariance: Annotated[
        tuple[tuple[float, ...], ...] | None,
        Key("Of the quantities of the key in their order, the same in all poses."),
    ] = None
    covariance_columns: Annotated[
        tuple[str | int, ...] | None,
        Key(
            "Columns of the data with the covariance in each pose: all of it row by row, or from "
            "the diagonal to the right (xx, xy, xz, yy, yz, zz)."
        ),
    ] = None
    tracker: Annotated[
        Annotated[Mapping[str, Any], Made(Tracker.of, later=True)] | None,
        Key(
            "Of the coordinates of a point together: a tracker by name, or its figures.",
            example={"range": "10 um + 0.3 um/m", "transverse": "15 um + 6 um/m"},
        ),
    ] = None
    station: Annotated[
        tuple[float, ...] | None, Key("Place of the tracker in the frame of its readings.")
    ] = None
    encoder: Annotated[
        Annotated[Mapping[str, Any], Made(encoder_sd, later=True)] | None,
        Key("Figures of an encoder; what is stated adds in quadrature.", example={"bits": 20}),
    ] = None
    rounded_to: Annotated[
        float | None,
        Key("Step of the readings: an sd of step / sqrt(12), in quadrature.", positive=True),
    ] = None
    unit: Annotated[
        str | None,
        Key("Of sd, rounded_to and station; a covariance is in its square.", is_unit=True),
    ] = None
    estimate: Annotated[
        str | None,
        Key(
            "Learn the sds from the calibration, beginning from those stated: one factor for each "
            "quantity of the key, or one for all. Absent: taken as given.",
            choices=("each", "group"),
        ),
    ] = None


def tracker_of(
    entry: StatedNoise, names: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Tracker:
    """The tracker of an entry for the coordinates, or the range and angles, `names`.

    Raises InputError for figures that cannot be used, and quantities that are neither.
    """
    tracker_place = place.at("tracker")
    native = [units[n] for n in names] == ["m", "rad", "rad"][: len(names)]
    if len(names) not in (2, 3) or not (native or {units[n] for n in names} == {"m"}):
        raise InputError(
            "a tracker measures the coordinates of a point, or its range, azimuth and "
            f"elevation, not {', '.join(names)}",
            code="wrong-shape",
            place=str(tracker_place),
            remedy='name them in order, say "x,y,z" or xyz',
        )
    if entry.sd is not None or entry.encoder is not None:
        other = "sd" if entry.sd is not None else "encoder"
        raise InputError(
            f"a tracker and {other} are stated for the same readings",
            code="conflicting-keys",
            place=str(place),
            remedy="give one of them",
        )
    at = place.at("unit")
    factor = in_si(1.0, entry.unit, "m", at, difference=True)
    station = None if entry.station is None else [factor * v for v in entry.station]
    step = factor * (entry.rounded_to or 0.0)
    if station is not None and len(station) != len(names):
        raise InputError(
            f"the station has {len(station)} coordinates, {', '.join(names)} are {len(names)}",
            code="wrong-shape",
            place=str(place.at("station")),
            remedy="give the tracker's place in the frame of its readings",
        )
    with placed(tracker_place):
        assert entry.tracker is not None
        return Tracker.of(**entry.tracker, station=station, rounded_to=step, native=native)


def sd_of(entry: StatedNoise, si: str, place: Place) -> float:
    """The sd [SI] of a quantity with SI unit `si`: sd, encoder and rounding in quadrature.

    Raises InputError for figures and units that do not fit the quantity.
    """
    at = place.at("unit")
    stated = 0.0 if entry.sd is None else in_si(entry.sd, entry.unit, si, at, difference=True)
    if entry.encoder is None and entry.rounded_to is None:
        return stated
    with placed(place.at("rounded_to"), unless_stated=True):
        rounding = rounding_sd(in_si(entry.rounded_to or 0.0, entry.unit, si, at, difference=True))
    encoder = 0.0 if entry.encoder is None else _encoder(entry.encoder, si, place.at("encoder"))
    return DatasheetSd(math.hypot(stated, encoder, rounding))


def _encoder(figures: Mapping[str, Any], si: str, place: Place) -> float:
    if ("bits" in figures or "counts" in figures) and si != "rad":
        raise InputError(
            f"bits and counts per turn are for angles, but this is of dimension "
            f"{unit(si).dimension}",
            code="wrong-unit",
            place=str(place),
            remedy="give the step of its readings: rounded_to = 1, unit = ...",
        )
    with placed(place, unless_stated=True):
        if "accuracy" in figures:
            in_si(1.0, accuracy_unit(figures["accuracy"]), si, place.at("accuracy"))
        return encoder_sd(**figures)


@dataclass(frozen=True)
class CovarianceColumns:
    """A covariance of some quantities that stands in columns of the data, one per pose."""

    quantities: tuple[str, ...]
    columns: tuple[str | int, ...]
    factor: float
    """To SI: the square of the unit's factor."""
    place: str

    def matrices(self, values: Array) -> Array:
        """(N, b, b) [SI squared] from the columns' values (c, N)."""
        size = len(self.quantities)
        if len(self.columns) == size * size:
            return np.ascontiguousarray(values.T.reshape(-1, size, size)) * self.factor
        full = np.empty((values.shape[1], size, size))
        # triu_indices goes row by row from the diagonal: xx, xy, xz, yy, yz, zz.
        for row, i, j in zip(values, *np.triu_indices(size), strict=True):
            full[:, i, j] = full[:, j, i] = row * self.factor
        return full


@dataclass(frozen=True)
class Noises:
    """The stated noise of sensors, in order: (quantities or quantity, sd or covariance [SI])."""

    entries: tuple[tuple[str | tuple[str, ...], Any], ...] = ()
    estimate: tuple[tuple[str | tuple[str, ...], str], ...] = ()
    """What is to be learnt: (key or quantities, "each" or "group")."""

    @property
    def columns(self) -> tuple[CovarianceColumns, ...]:
        """The covariances that have to be read with the data."""
        return tuple(v for _, v in self.entries if isinstance(v, CovarianceColumns))

    def sd_of(self, quantity: str) -> float | None:
        """The sd [SI] stated for a quantity as a whole, None if none or by covariance."""
        sd = None
        for key, value in self.entries:
            if key == quantity:
                sd = float(value)
            elif isinstance(key, tuple) and quantity in key:
                sd = None
        return sd

    def followed_by(self, other: Noises) -> Noises:
        """These entries and then the others, which win."""
        stated = {q for k, _ in other.entries for q in _names(k)}
        kept = [(k, v) for k, v in self.entries if not stated.issuperset(_names(k))]
        return Noises((*kept, *other.entries), self.estimate + other.estimate)

    def noise(self, covariances: Mapping[tuple[str, ...], Array] | None = None) -> Noise:
        """The noise, with the covariances (N, b, b) of the columns that were read.

        Raises InputError where a covariance by pose is stated and none was read.
        """
        made: dict[str | tuple[str, ...], Any] = {}
        for key, value in self.entries:
            if isinstance(value, CovarianceColumns):
                if covariances is None or value.quantities not in covariances:
                    raise InputError(
                        "a covariance from columns of the data cannot be simulated",
                        code="unsupported",
                        place=value.place,
                        remedy="state the noise of the simulation in [simulation.noise]",
                    )
                value = covariances[value.quantities]
            made.pop(key, None)  # the later line shall also stand later
            made[key] = value
        return Noise(made, estimate=dict(self.estimate))


def _names(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


def noises(entries: Mapping[str, StatedNoise], mechanism: Mechanism, place: Place) -> Noises:
    """The noise of a table.

    Raises InputError for unknown quantities, units that do not fit, and matrices that are none.
    """
    noise_entries: list[tuple[str | tuple[str, ...], Any]] = []
    learnt: list[tuple[str | tuple[str, ...], str]] = []
    units: Mapping[str, str] = mechanism.quantities
    for key, entry in entries.items():
        entry_place = place.at(key)
        if key == MODEL:
            names: tuple[str, ...] = (MODEL,)
            units = {**units, MODEL: unit(entry.unit).si if entry.unit else "m"}
        else:
            with placed(entry_place):
                listed = [mechanism.quantity_group(part.strip()) for part in key.split(",")]
            names = tuple(dict.fromkeys(chain.from_iterable(listed)))
        if entry.estimate is not None:
            learnt.append((key if "," not in key else names, entry.estimate))
        kind = _kind(entry, entry_place)
        if kind == "scalar":
            noise_entries += [(n, sd_of(entry, units[n], entry_place)) for n in names]
        elif kind == "tracker":
            noise_entries.append((names, tracker_of(entry, names, units, entry_place)))
        else:
            noise_entries.append((names, _covariance(entry, names, units, entry_place)))
    return Noises(tuple(noise_entries), tuple(learnt))


def _kind(entry: StatedNoise, place: Place) -> str:
    """The one kind of noise that is stated: scalar, tracker, covariance, covariance_columns."""
    keys = [k for k in ("sd", "encoder", "rounded_to") if getattr(entry, k) is not None]
    kinds = ["scalar"] if keys else []
    if entry.tracker is not None:
        keys, kinds = ["tracker", *keys], ["tracker"]  # which says what it cannot go with
    elif entry.station is not None:
        raise InputError(
            "station needs a tracker",
            code="conflicting-keys",
            place=str(place.at("station")),
            remedy='name the tracker, say tracker = "leica-at500"',
        )
    wide = [k for k in ("covariance", "covariance_columns") if getattr(entry, k) is not None]
    if len(kinds + wide) != 1:
        raise InputError(
            f"{' and '.join(keys + wide) or 'no sd'} is stated",
            code="missing-sd",
            place=str(place),
            remedy="give sd, encoder, rounded_to or tracker, or else covariance or "
            "covariance_columns",
        )
    return (kinds + wide)[0]


def _covariance(
    entry: StatedNoise, names: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Any:
    dimensions = {unit(units[name]).dimension for name in names}
    if len(dimensions) > 1 and entry.unit is not None:
        raise InputError(
            f"a covariance of {' and '.join(sorted(dimensions))} cannot be in {entry.unit}",
            code="wrong-unit",
            place=str(place.at("unit")),
            remedy="remove unit and give the covariance in SI (m, rad)",
        )
    for name in names:
        in_si(1.0, entry.unit, units[name], place.at("unit"))
    factor = unit(entry.unit).factor ** 2 if entry.unit else 1.0
    size = len(names)
    if entry.covariance_columns is not None:
        columns = tuple(entry.covariance_columns)
        if len(columns) not in (size * size, size * (size + 1) // 2):
            raise InputError(
                f"{len(columns)} columns are named for the covariance of {', '.join(names)}",
                code="invalid-covariance",
                place=str(place.at("covariance_columns")),
                remedy=f"name {size * (size + 1) // 2} (xx, xy, ..., from the diagonal to the "
                f"right) or {size * size} (row by row)",
            )
        return CovarianceColumns(names, columns, factor, str(place))
    assert entry.covariance is not None
    if [len(row) for row in entry.covariance] != [size] * size:
        raise InputError(
            f"the covariance of {', '.join(names)} is not {size} by {size}",
            code="invalid-covariance",
            place=str(place.at("covariance")),
            remedy=f"give {size} rows of {size} numbers",
        )
    matrix = np.array(entry.covariance) * factor
    with placed(place.at("covariance")):
        # Made to be checked here, where the key of a faulty matrix is known.
        Noise({names: matrix})
    return matrix
