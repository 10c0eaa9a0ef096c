"""A point of the body, read as coordinates in the frame of a station: trackers, arms, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.frame import Frame, Values
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.station import LookedAt, Name, StandsAt, Station, Target

AXES = ("x", "y", "z")
Coordinates = Annotated[
    Sequence[str] | None, Key("Names of the coordinates. Default: x, y, z; in a plane x, y.")
]
_Flat = Annotated[
    Sequence[str] | None,
    Key(
        "Names of the coordinates. Default: x, y, z; in a plane x, y. Two names in space: what "
        "reads x and y alone, such as a grid encoder; STATION_z is then left out."
    ),
]


@recorded
def point(
    name: Name = "point",
    *,
    readings: _Flat = None,
    station: StandsAt = "base",
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """Cartesian coordinates of a target in the frame of a station.

    Loops: T_station_base T_base_body p_target - (x, y, z) = 0 [m], in a plane x and y alone.
    readings: names of the coordinates, by default x, y and z; of two in space z is not read, and
    the station has no STATION_z; station: name of the station, whose
    six parameters (three in a plane) are STATION_x ... STATION_rx, None where coordinates are those
    of the machine's base; target: the point fixed to the body, by its name (parameters TARGET_x,
    _y, _z) or as a `Target`.

    Raises InputError for a number of coordinates that is not the dimension.
    """
    coordinates = tuple(AXES[:dimension] if readings is None else readings)
    if len(coordinates) not in (2, dimension):
        raise InputError(
            f"the instrument {name!r} reads {len(coordinates)} coordinates of a point in a space "
            f"of {dimension}",
            code="wrong-shape",
            remedy="name x and y" if dimension == 2 else "name x, y and z, or x and y",
        )
    stands = Station(station, dimension, flat=len(coordinates) < dimension)
    looked_at = Target.of(target, dimension)

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        seen = stands.seen(frames[0].point(looked_at.point(p)), p)
        return [seen[i] - x[reading] for i, reading in enumerate(coordinates)]

    return Instrument(
        name,
        dict.fromkeys(coordinates, "m"),
        looked_at.declared,
        equations,
        "point",
        mounted=looked_at.parameters,
        placement=stands.declared,
        place=None if station is None else stands,
        dimension=dimension,
    )
