"""Makers' figures turned into sds: trackers by range and transverse, encoders by their steps.

A figure a + b L grows with the distance L from the instrument. A maximum permissible error (mpe)
is a bound, not an sd: sd = mpe / coverage, with coverage 2 unless stated (makers of trackers call
half of it typical). It is sqrt(3) where every error within the bound is equally likely ("uniform",
GUM 4.3.7). Rounding to a step leaves a uniform error of sd = step / sqrt(12).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, nearest, unknown_name
from loopcal.keys import Key
from loopcal.units import unit

KINDS = ("mpe", "sd")
BoundKind = Annotated[
    str | None, Key("mpe: maximum permissible error (unless stated); or sd.", choices=KINDS)
]
Coverage = Annotated[
    float | str | None,
    Key(
        'Maximum permissible error over sd: 2, or "uniform" (sqrt 3).',
        positive=True,
        choices=("uniform",),
    ),
]
TYPICAL = 2.0
"""Maximum permissible error over sd, where nothing else is stated."""
_NOWHERE = 1e-9
"""Points nearer to the instrument [m] are no measurements."""
_TERM = re.compile(r"([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([^\s/0-9.+]+)\s*(?:/\s*([^\s/0-9.+]+))?")


@dataclass(frozen=True)
class LengthFigure:
    """constant + per_metre * L [m], L [m] being the distance from the instrument."""

    constant: float
    per_metre: float

    def at(self, distance: Array) -> Array:
        """The figure [m] at distances [m]."""
        return self.constant + self.per_metre * distance


@dataclass(frozen=True)
class Preset:
    """A maker's figures as printed: range and transverse as texts, of one kind."""

    range: str
    transverse: str
    kind: str


PRESETS = {
    # Its figure for the range's zero (R0, +-5 um) is one shift of all readings, no scatter.
    "leica-at500": Preset("10 um + 0.3 um/m", "15 um + 6 um/m", "mpe"),
}
"""Trackers whose makers' figures we know; Leica AT500: maximum permissible errors, typical half."""


class DatasheetSd(float):
    """An sd [SI] that follows from a maker's figure; a number like any other."""


@dataclass(frozen=True)
class Tracker:
    """An instrument that measures points by distance and direction, as uncertain as its maker says.

    range, transverse: sds along and across the line of sight; station: where the instrument
    stands in the frame of its coordinates [m], None for the origin; rounding: sd [m] of
    every coordinate's last digit; native: its readings are not coordinates but range, azimuth and
    elevation (in a plane without it). As the value of a `Noise` entry for the readings together it
    gives each the covariance of the place where it was taken.
    """

    range: LengthFigure
    transverse: LengthFigure
    station: tuple[float, ...] | None = None
    rounding: float = 0.0
    native: bool = False
    ndim: ClassVar[int] = 0
    """As of an array: it stands for any number of poses."""

    @classmethod
    def of(
        cls,
        name: Annotated[
            str | None, Key("Name of the tracker.", alone=True, example="leica-at500")
        ] = None,
        *,
        range: Annotated[  # noqa: A002
            str | None, Key("Along the line of sight.", example="10 um + 0.3 um/m")
        ] = None,
        transverse: Annotated[
            str | None,
            Key(
                "Across the line of sight, in each of the two directions.",
                example="15 um + 6 um/m",
            ),
        ] = None,
        kind: BoundKind = None,
        coverage: Coverage = None,
        station: ArrayLike | None = None,
        rounded_to: float = 0.0,
        native: bool = False,
    ) -> Tracker:
        """A tracker by the name of a preset, or from its range and transverse figures.

        kind: "mpe" (the default) or "sd"; coverage: mpe over sd, 2 by default, or "uniform";
        rounded_to: step [m] of the coordinates as written. Transverse holds for each of the two
        directions across the line of sight; as an angle ("2 arcsec") it grows with distance.

        >>> f"{1e6 * Tracker.of('leica-at500').transverse.constant:.1f} um, half of 15 um"
        '7.5 um, half of 15 um'

        Raises InputError for a name, figure or kind that is none.
        """
        if name is not None:
            if range is not None or transverse is not None or kind is not None:
                raise InputError(
                    f"the tracker {name!r} is named, but figures are given as well",
                    code="conflicting-keys",
                    remedy="give the name, or range, transverse and kind",
                )
            if name not in PRESETS:
                raise InputError(
                    f"the tracker {name!r} is not known",
                    code="unknown-name",
                    remedy=f"{nearest(name, PRESETS).rstrip('?')}, or give its maker's figures, "
                    'say { range = "10 um + 0.3 um/m", transverse = "15 um + 6 um/m" }',
                )
            preset = PRESETS[name]
            range, transverse, kind = preset.range, preset.transverse, preset.kind  # noqa: A001
        if range is None or transverse is None:
            missing = "range" if range is None else "transverse"
            raise InputError(
                f"the {missing} figure of the tracker is missing",
                code="missing-key",
                remedy='give both, say range = "10 um + 0.3 um/m", transverse = "15 um + 6 um/m"',
            )
        if native and (station is not None or rounded_to):
            raise InputError(
                "station and rounded_to are for coordinates, but ranges and angles are read",
                code="conflicting-keys",
                remedy="leave them out",
            )
        factor = sd_per_figure(kind or "mpe", coverage)
        place = None if station is None else tuple(np.asarray(station, dtype=float).tolist())
        return cls(
            length_figure(range, factor),
            length_figure(transverse, factor),
            place,
            rounding_sd(rounded_to),
            native,
        )

    def covariance(self, points: ArrayLike) -> Array:
        """Covariances (N, d, d) [m^2] of points (N, d) [m] in space or in a plane, d = 3 or 2.

        With r = point - station, u = r/|r|: sd_range^2 u u^T + sd_transverse^2 (I - u u^T).
        Native readings (range r, azimuth, elevation e) instead of points: diagonal, sd_range,
        sd_transverse / (r cos e) and sd_transverse / r [m, rad]. Raises InputError for a point
        where the instrument stands.
        """
        r = np.asarray(points, dtype=np.float64)
        if r.ndim != 2 or r.shape[1] not in (2, 3):
            raise InputError(
                f"the points have the shape {r.shape}",
                code="wrong-shape",
                remedy="give (N, 3), or (N, 2) in a plane",
            )
        if self.station is not None and len(self.station) != r.shape[1]:
            raise InputError(
                f"the station has {len(self.station)} coordinates, a point {r.shape[1]}",
                code="wrong-shape",
                remedy="give the instrument's place in the frame of the points",
            )
        lost = self.at_station(r)
        if lost.size:
            raise InputError(
                f"point {int(lost[0]) + 1} is at the tracker itself",
                code="lost-reflector",
                remedy="exclude it: a tracker writes 0, 0, 0 for a lost reflector",
            )
        if self.native:
            return self._of_readings(r)
        if self.station is not None:
            r = r - np.array(self.station)
        distance = np.linalg.norm(r, axis=1)
        u = r / distance[:, None]
        along = u[:, :, None] * u[:, None, :]
        across = np.eye(r.shape[1]) - along
        variance = np.square([self.range.at(distance), self.transverse.at(distance)])
        of_direction = variance[0][:, None, None] * along + variance[1][:, None, None] * across
        # Rounding is independent of the direction and alike in each coordinate.
        covariance: Array = of_direction + self.rounding**2 * np.eye(r.shape[1])
        return covariance

    def _of_readings(self, readings: Array) -> Array:
        distance, across = readings[:, 0], self.transverse.at(readings[:, 0]) / readings[:, 0]
        sds = [self.range.at(distance), across]
        if readings.shape[1] == 3:
            # An azimuth moves the point by range * cos(elevation), so its sd grows towards the
            # zenith.
            sds = [sds[0], across / np.cos(readings[:, 2]), across]
        return np.square(sds).T[:, :, None] * np.eye(len(sds))

    def at_station(self, points: Array) -> NDArray[np.intp]:
        """Positions of the points (N, d) that lie where the instrument stands."""
        if self.native:
            return np.flatnonzero(np.abs(points[:, 0]) < _NOWHERE)
        r = points if self.station is None else points - np.array(self.station)
        return np.flatnonzero(np.linalg.norm(r, axis=1) < _NOWHERE)


def tracker_covariance(
    points: ArrayLike,
    name: str | None = None,
    *,
    range: str | None = None,  # noqa: A002
    transverse: str | None = None,
    kind: str | None = None,
    coverage: float | str | None = None,
    station: ArrayLike | None = None,
    rounded_to: float = 0.0,
) -> Array:
    """Covariances (N, d, d) [m^2] of a tracker's readings of points (N, d) [m]; see `Tracker`.

    >>> far = tracker_covariance([[10.0, 0.0, 0.0]], "leica-at500")[0]
    >>> [round(1e6 * variance ** 0.5, 1) for variance in far.diagonal().tolist()]
    [6.5, 37.5, 37.5]

    Raises InputError as `Tracker.of` and `Tracker.covariance` do.
    """
    tracker = Tracker.of(
        name,
        range=range,
        transverse=transverse,
        kind=kind,
        coverage=coverage,
        station=station,
        rounded_to=rounded_to,
    )
    return tracker.covariance(points)


def encoder_sd(
    *,
    bits: Annotated[
        int | None, Key("It distinguishes 2^bits positions per turn.", low=1, high=64)
    ] = None,
    counts: Annotated[float | None, Key("Or so many positions per turn.", positive=True)] = None,
    accuracy: Annotated[str | None, Key("Its bound or sd with a unit.", example="5 arcsec")] = None,
    kind: BoundKind = None,
    coverage: Coverage = None,
    gear: Annotated[
        float, Key("Turns of the encoder per turn of the joint, which divide all.", positive=True)
    ] = 1.0,
    rounded_to: float = 0.0,
) -> float:
    """The sd [SI] of an encoder, its parts added in quadrature.

    bits: it distinguishes 2^bits positions per turn; counts: or so many (lines times interpolation,
    edges included); accuracy: a bound or sd with its unit, "5 arcsec" or "3 um", of the `kind`
    "mpe" (default; over `coverage`, 2 or "uniform") or "sd"; gear: turns of the encoder per turn
    of the joint, which divide all of these; rounded_to: step [SI] of the readings as written.
    A step leaves sd = step / sqrt(12).

    >>> f"{1e6 * encoder_sd(bits=20):.3f} urad, {1e6 * encoder_sd(counts=4096):.0f} urad"
    '1.730 urad, 443 urad'

    Raises InputError where nothing is given, or what cannot be.
    """
    variance, parts = rounding_sd(rounded_to) ** 2, rounded_to > 0.0
    if bits is not None and counts is not None:
        raise InputError(
            "bits and counts are both given", code="conflicting-keys", remedy="give one of them"
        )
    if accuracy is None and (kind is not None or coverage is not None):
        raise InputError(
            "kind and coverage need an accuracy",
            code="conflicting-keys",
            remedy='give accuracy = "5 arcsec", or leave them out',
        )
    positive("gear", gear)
    if bits is not None:
        counts = math.ldexp(1.0, int(positive("bits", min(bits, 64))))
    if counts is not None:
        step = 2 * math.pi / positive("counts", counts) / gear
        variance, parts = variance + rounding_sd(step) ** 2, True
    if accuracy is not None:
        bound = accuracy_figure(accuracy)
        sd = sd_per_figure(kind or "mpe", coverage) * bound / gear
        variance, parts = variance + sd**2, True
    if not parts:
        raise InputError(
            "the encoder has no figures",
            code="missing-key",
            remedy='give bits = 20, counts = 4096 or accuracy = "5 arcsec"',
        )
    return DatasheetSd(math.sqrt(variance))


def rounding_sd(step: float) -> float:
    """The sd step / sqrt(12) that rounding to a step leaves; InputError below zero."""
    if not 0.0 <= step < math.inf:
        raise InputError(
            f"readings cannot be rounded to {step:g}",
            code="invalid-value",
            remedy="give the step, a number above 0",
        )
    # Uniform within half a step to either side: variance (step / 2)^2 / 3.
    return step / math.sqrt(12.0)


def sd_per_figure(kind: str, coverage: float | str | None) -> float:
    """What turns a figure of this kind into an sd: 1, or 1 / coverage."""
    if kind not in KINDS:
        raise unknown_name(f"the kind of figure is {kind!r}", kind, KINDS)
    if kind == "sd":
        if coverage is not None:
            raise InputError(
                "coverage does not apply to an sd",
                code="conflicting-keys",
                remedy='remove coverage, or set kind = "mpe"',
            )
        return 1.0
    if isinstance(coverage, str):
        if coverage != "uniform":
            raise InputError(
                f"the coverage is {coverage!r}",
                code="invalid-value",
                remedy='give a number such as 2, or "uniform"',
            )
        # A uniform error within +-a has the variance a^2 / 3 (GUM 4.3.7).
        return 1.0 / math.sqrt(3.0)
    return 1.0 / positive("coverage", TYPICAL if coverage is None else coverage)


def length_figure(text: str, factor: float = 1.0) -> LengthFigure:
    """The figure of a text such as "15 um + 6 um/m", times a factor.

    Raises InputError for a text that is none, or of another dimension.
    """
    constant = slope = 0.0
    for number, name, per in _terms(text, '"15 um + 6 um/m"'):
        stated_unit = unit(name)
        if per is None and stated_unit.dimension == "length":
            constant += number * stated_unit.factor
        elif per is None and stated_unit.dimension == "angle":
            slope += number * stated_unit.factor
        elif per is not None and stated_unit.dimension == unit(per).dimension == "length":
            slope += number * stated_unit.factor / unit(per).factor
        else:
            raise InputError(
                f"{text!r} is not a length that grows with distance",
                code="unknown-unit",
                remedy='give lengths and lengths per length, say "15 um + 6 um/m"',
            )
    return LengthFigure(factor * constant, factor * slope)


def accuracy_figure(text: str) -> float:
    """The one number [SI] of a text such as "5 arcsec"; see `accuracy_unit` for its unit."""
    number, name, _ = _one_term(text)
    return number * unit(name).factor


def accuracy_unit(text: str) -> str:
    """The unit in which an accuracy such as "5 arcsec" is stated."""
    return _one_term(text)[1]


def _one_term(text: str) -> tuple[float, str, str | None]:
    terms = _terms(text, '"5 arcsec"')
    if len(terms) != 1 or terms[0][2] is not None:
        raise InputError(
            f"{text!r} is more than one number with its unit",
            code="unknown-unit",
            remedy='give it as "5 arcsec"',
        )
    return terms[0]


def _terms(text: str, example: str) -> list[tuple[float, str, str | None]]:
    """number, unit, and the unit it is per, of every summand."""
    terms = []
    for part in text.replace("±", " ").replace("+-", " ").split("+"):
        match = _TERM.fullmatch(part.strip())
        try:
            number = math.nan if match is None else float(match[1])
        except ValueError:
            number = math.nan
        if match is None or math.isnan(number):
            raise InputError(
                f"{text!r} cannot be read as a figure with its unit",
                code="unknown-unit",
                remedy=f"write it as {example}",
            )
        terms.append((number, match[2], match[3]))
    return terms


def positive(what: str, value: float) -> float:
    """The value; InputError unless it is a finite number above zero."""
    if not 0.0 < value < math.inf:
        raise InputError(
            f"{what} is {value:g}", code="invalid-value", remedy="give a number above 0"
        )
    return value
