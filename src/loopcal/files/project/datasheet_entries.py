"""Makers' figures as project files state them: trackers, encoders and rounding, turned into SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from loopcal.errors import InputError
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.measurements.datasheet import (
    DatasheetSd,
    Tracker,
    accuracy_unit,
    encoder_sd,
    rounding_sd,
)
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import EncoderEntry, NoiseEntry


def tracker_of(
    entry: NoiseEntry, names: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Tracker:
    """The tracker of an entry for the coordinates, or the range and angles, `names`.

    Raises InputError for figures that cannot be used, and quantities that are neither.
    """
    here = place.at("tracker")
    native = [units[n] for n in names] == ["m", "rad", "rad"][: len(names)]
    if len(names) not in (2, 3) or not (native or {units[n] for n in names} == {"m"}):
        raise InputError(
            "a tracker measures the coordinates of a point, or its range, azimuth and "
            f"elevation, not {', '.join(names)}",
            code="wrong-shape",
            place=str(here),
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
    try:
        assert entry.tracker is not None
        figures = entry.tracker.model_dump(exclude_none=True)
        return Tracker.of(**figures, station=station, rounded_to=step, native=native)
    except InputError as error:
        raise error.at(str(here)) from None


def sd_of(entry: NoiseEntry, si: str, place: Place) -> float:
    """The sd [SI] of a quantity with SI unit `si`: sd, encoder and rounding in quadrature.

    Raises InputError for figures and units that do not fit the quantity.
    """
    at = place.at("unit")
    stated = 0.0 if entry.sd is None else in_si(entry.sd, entry.unit, si, at, difference=True)
    if entry.encoder is None and entry.rounded_to is None:
        return stated
    try:
        rounding = rounding_sd(in_si(entry.rounded_to or 0.0, entry.unit, si, at, difference=True))
    except InputError as error:
        raise error if error.place else error.at(str(place.at("rounded_to"))) from None
    own = 0.0 if entry.encoder is None else _encoder(entry.encoder, si, place.at("encoder"))
    return DatasheetSd(math.hypot(stated, own, rounding))


def _encoder(entry: EncoderEntry, si: str, place: Place) -> float:
    if (entry.bits is not None or entry.counts is not None) and si != "rad":
        raise InputError(
            f"bits and counts per turn are for angles, but this is of dimension "
            f"{unit(si).dimension}",
            code="wrong-unit",
            place=str(place),
            remedy="give the step of its readings: rounded_to = 1, unit = ...",
        )
    try:
        if entry.accuracy is not None:
            in_si(1.0, accuracy_unit(entry.accuracy), si, place.at("accuracy"))
        return encoder_sd(**entry.model_dump(exclude_none=True))
    except InputError as error:
        raise error if error.place else error.at(str(place)) from None
