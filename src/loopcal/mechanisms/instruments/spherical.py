"""A tracker in its native readings: range, azimuth and elevation of a reflector on the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.expressions.vectors import norm
from loopcal.keys import Key
from loopcal.mechanisms.frame import Frame, Values
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.station import LookedAt, Name, OwnStation, Station, Target

NATIVE = ("range", "azimuth", "elevation")
_ZEROS = (("range", "m"), ("elevation", "rad"))


Natives = Annotated[
    Sequence[str] | None,
    Key("Names of the readings. Default: NAME_range, NAME_azimuth, NAME_elevation."),
]
Offsets = Annotated[
    bool, Key("Whether STATION_range_offset and STATION_elevation_offset are estimated.")
]


@recorded
def spherical(
    name: Name = "tracker",
    *,
    readings: Natives = None,
    station: OwnStation = None,
    target: LookedAt = "tool",
    dimension: int = 3,
    offsets: Offsets = False,
) -> Instrument:
    """Range [m], azimuth and elevation [rad] of a target, seen from a station.

    With q = T_station_base T_base_body p_target = (x, y, z) and rho = sqrt(x^2 + y^2):

        |q| + range_offset - range = 0
        arg[(x + i y) exp(-i azimuth)] = 0
        arg[(rho + i z) exp(-i (elevation - elevation_offset))] = 0

    Each loop is linear in its own reading with slope -1, so an sd of an angle is that of an angle;
    arg lies within half a turn, so azimuths may differ by whole turns and nothing jumps near a
    solution. In a plane range and azimuth alone.

    readings: their names, by default NAME_range, NAME_azimuth and NAME_elevation; station: name
    of the station (default: that of the instrument), whose six parameters, three in a plane, are
    STATION_x ... STATION_rx; several reflectors seen from one station share its name. target: as
    for `point`. The azimuth counts from x towards y, the elevation from that plane up. offsets:
    two more parameters STATION_range_offset [m] and STATION_elevation_offset [rad] (one of the
    azimuth is indistinguishable from the station's rz).

    Raises InputError for a number of readings that does not fit.
    """
    native = NATIVE[:dimension]
    names = tuple(f"{name}_{what}" for what in native) if readings is None else tuple(readings)
    if len(names) != dimension:
        raise InputError(
            f"the instrument {name!r} has {len(names)} readings, but in {dimension} dimensions "
            f"a tracker reads {', '.join(native)}",
            code="wrong-shape",
            remedy=f"name {dimension} readings",
        )
    stands = Station(name if station is None else station, dimension)
    looked_at = Target.of(target, dimension)
    units = dict(zip(names, ("m", "rad", "rad"), strict=False))
    zeros = {f"{stands.name}_{what}_offset": u for what, u in _ZEROS[: dimension - 1] if offsets}

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        q = stands.seen(frames[0].point(looked_at.point(p)), p)
        distance, azimuth, *height = (x[reading] for reading in names)
        loops = [norm(q) - distance, turn_between(q[0], q[1], azimuth)]
        for angle in height:
            loops.append(turn_between(np.hypot(q[0], q[1]), q[2], angle))
        for i, zero in zip((0, 2), zeros, strict=False):
            loops[i] = loops[i] + p[zero]
        return loops

    return Instrument(
        name,
        units,
        looked_at.declared | {n: Parameter(n, 0.0, u) for n, u in zeros.items()},
        equations,
        "spherical" if dimension == 3 else "polar",
        placement=stands.declared,
        mounted=looked_at.parameters,
        place=stands,
        dimension=dimension,
        remedy=f"the target is where the station {stands.name!r} stands, or straight above it: "
        "start by aligning points, or give the station its nominal place",
    )


def turn_between(c: Any, s: Any, angle: Any) -> Any:
    """The direction (c, s) less an angle [rad], within half a turn: arg[(c + i s) e^(-i angle)]."""
    # The angle is taken out before the arctangent: its branch cut then lies half a turn away.
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.arctan2(s * cosine - c * sine, c * cosine + s * sine)
