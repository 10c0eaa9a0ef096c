"""Scales of several stations: each multiplies the lengths that it reads by one factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Name
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.parameters import Parameter

SD = 1e-5
"""Prior sd of a scale: of trackers and arms by their data sheets, and of 10 K of air."""
_LENGTHS = {"point": 3, "pose": 3, "spherical": 1, "polar": 1}
"""What reads lengths from where it stands, and how many of its readings are lengths."""


@dataclass(frozen=True)
class StationScales:
    """Stations with scales s_k: station k reads a length times 1 + s_k t.

    The machine and all else that is read are as the first station sees them, in proportion:

        p' = p (1 + s_1 t) of the machine's lengths,
        x' = x (1 + (s_1 - s_k) t) of what station k reads,
        x' = x (1 + s_1 t) of slides and other lengths.

    Scales of the readings alone would shrink them to nothing, because their noise shrinks too.

    column: the known constant t, 1 in what is calibrated. Readings to predict from that lack it
    are true lengths, t = 0. Without a column t = 1 always: predictions are as each station reads.

    >>> StationScales("in_calibration").latest()
    {'in_calibration': 0.0}

    Raises InputError where lengths are read from fewer than two stations.
    """

    column: Annotated[
        str,
        Key("Known constant that is 1 in what is calibrated, 0 for true lengths. Default: 1."),
    ] = ""
    name: Name = "station_scales"

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """INSTRUMENT_scale of each station, by its first instrument."""
        stations = by_station(mechanism)
        if len(stations) < 2:
            raise InputError(
                f"the effect {self.name!r} compares stations, and lengths are read from "
                f"{len(stations)} of them",
                code="unsupported",
                remedy="remove the effect, or add the instrument of another station",
            )
        return one_each(stations, "scale", "1", SD, "scale")

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """The column."""
        return {self.column: "1"} if self.column else {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The lengths of the machine, and those that are read, but by the first station."""
        first, *others = by_station(mechanism)
        t, seen = x[self.column] if self.column else 1.0, p[named(first, "scale")]
        scales = {q: seen - p[named(one, "scale")] for one in others for q in lengths_read(one)}
        still = lengths_read(first)
        for v in mechanism.variables:
            if (v.role, v.unit, v.first) == ("reading", "m", None) and v.name not in still:
                scales.setdefault(v.name, seen)
        parameters = mechanism.parameters
        return {
            **{q.name: p[q.name] * (1.0 + seen * t) for q in parameters if _grows(q)},
            **{name: x[name] * (1.0 + scale * t) for name, scale in scales.items()},
        }

    def latest(self) -> dict[str, float]:
        """The column, where lengths are true."""
        return {self.column: 0.0} if self.column else {}


def by_station(mechanism: Mechanism) -> list[list[Family]]:
    """The instruments that read lengths, by where they stand."""
    groups: dict[tuple[str, ...], list[Family]] = {}
    for family in mechanism.families:
        if family.form in _LENGTHS:
            groups.setdefault(tuple(family.standing), []).append(family)
    return list(groups.values())


def lengths_read(instruments: Sequence[Family]) -> list[str]:
    """The readings of instruments that are lengths from where these stand."""
    return [q for f in instruments for q in f.readings[: _LENGTHS[f.form]]]


def _grows(parameter: Parameter) -> bool:
    """Whether it is a length of the machine or of what is mounted on it.

    A station stands where it is seen: predictions keep that place.
    """
    return parameter.unit == "m" and parameter.role != "placement"


def named(instruments: Sequence[Family], what: str) -> str:
    """INSTRUMENT_what of a station, after its first instrument."""
    return f"{instruments[0].name}_{what}"


def one_each(
    stations: Sequence[Sequence[Family]], what: str, unit: str, sd: float, meaning: str
) -> dict[str, Parameter]:
    """A parameter of each station, zero but for its prior sd [SI]."""
    names = {named(one, what): one[0].name for one in stations}
    return {
        name: Parameter(name, 0.0, unit, sd, meaning=f"{meaning} of {first}")
        for name, first in names.items()
    }
