"""What the instrument and the frame add to a measured pose, as the user states it.

Two kinds of error are kept apart. What differs from reading to reading is in the scatter and is the
instrument's share of repeatability. What all readings of a pose share is not in the scatter: it
makes the mean position uncertain, however many cycles there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.measurements.datasheet import Tracker, accuracy_figure, accuracy_unit
from loopcal.units import unit


@dataclass(frozen=True)
class Figures:
    """A length [m] and an angle [rad]; None for what is not stated."""

    length: float | None = None
    angle: float | None = None

    @classmethod
    def of(cls, text: str | None) -> Figures:
        """From a text such as "5 um" or "5 um, 20 urad".

        Raises InputError for anything else.
        """
        figures: dict[str, float] = {}
        for part in () if text is None else text.split(","):
            dimension = unit(accuracy_unit(part)).dimension
            if dimension not in ("length", "angle") or dimension in figures:
                raise InputError(
                    f"{text!r} is not a length, an angle or both",
                    code="wrong-unit",
                    remedy='give sds as "5 um" or "5 um, 20 urad"',
                )
            figures[dimension] = accuracy_figure(part)
        return cls(figures.get("length"), figures.get("angle"))


@dataclass(frozen=True)
class MeasuringErrors:
    """What is known of the errors of measuring.

    reading: sd of one reading in each coordinate and about each axis, independent from reading to
    reading; tracker: what all readings of one point share, as a data sheet states it; frame: sd of
    the commanded frame in the instrument's, shift in each coordinate and turn about each axis;
    planar: only x and y are measured.
    """

    reading: Figures = Figures()
    tracker: Tracker | None = None
    frame: Figures = Figures()
    planar: bool = False

    def of_reading(self, point: Array) -> Array | None:
        """Covariance (3, 3) [m^2] that one reading adds to the scatter; None if unknown.

        From a data sheet alone this is the most it can be.
        """
        if self.reading.length is not None:
            return self._measured(self.reading.length**2 * np.eye(3))
        return self.of_point(point) if self.tracker is not None else None

    def of_point(self, point: Array) -> Array:
        """Covariance (3, 3) [m^2] of what all readings of one point share."""
        if self.tracker is None:
            return np.zeros((3, 3))
        return self._measured(np.asarray(self.tracker.covariance(point[None])[0]))

    def _measured(self, covariance: Array) -> Array:
        """The covariance of what is measured of a point."""
        measured_axes = np.array([1.0, 1.0, 0.0 if self.planar else 1.0])
        return covariance * np.outer(measured_axes, measured_axes)

    def words(self) -> list[str]:
        """What is not stated, and what follows."""
        said = []
        if self.tracker is None and self.frame.length is None:
            said.append(
                "Intervals of AP hold the scatter alone: neither a tracker nor the uncertainty of "
                "the frame is stated (--tracker, --frame-sd)."
            )
        elif self.frame.length is None:
            said.append("The uncertainty of the frame is not stated (--frame-sd).")
        elif self.tracker is None:
            said.append("Errors that the instrument repeats are not stated (--tracker).")
        if self.reading.length is None and self.tracker is None:
            said.append("The instrument's share of RP is not stated (--instrument-sd).")
        return said


def tracker_of(text: str | None, station: str | None = None) -> Tracker | None:
    """A tracker from its name, or from "RANGE, TRANSVERSE" as a maker prints them (MPE).

    station: "x, y, z" with a unit each, where the instrument stands in the frame of the readings.
    Raises InputError for what is neither.
    """
    if text is None:
        if station is not None:
            raise InputError(
                "a station is given, but no tracker",
                code="conflicting-keys",
                remedy="give --tracker too",
            )
        return None
    place = None
    if station is not None:
        place = [_coordinate(part, station) for part in station.split(",")]
        if len(place) != 3:
            raise InputError(
                f"the station {station!r} has {len(place)} coordinates",
                code="wrong-shape",
                remedy='give three, say "-2 m, 0.5 m, 1 m"',
            )
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 1:
        return Tracker.of(parts[0], station=place)
    if len(parts) != 2:
        raise InputError(
            f"{text!r} is not a tracker",
            code="invalid-value",
            remedy='give a name, or range and transverse: "10 um + 0.3 um/m, 15 um + 6 um/m"',
        )
    return Tracker.of(range=parts[0], transverse=parts[1], station=place)


def _coordinate(part: str, whole: str) -> float:
    """A signed length [m]."""
    text = part.strip()
    size = text.lstrip("+-").strip()
    if unit(accuracy_unit(size)).dimension != "length":
        raise InputError(
            f"the station {whole!r} is not a place",
            code="wrong-unit",
            remedy='give lengths, say "-2 m, 0.5 m, 1 m"',
        )
    return -accuracy_figure(size) if text.startswith("-") else accuracy_figure(size)
