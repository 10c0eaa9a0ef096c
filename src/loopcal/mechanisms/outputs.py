"""Which outputs belong together: those that one instrument reads, as positions and as angles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.station import Station

POLAR = ("spherical", "polar")
"""Forms of readings that are a distance and one or two angles."""


@dataclass(frozen=True)
class Seen:
    """What one instrument sees of the mechanism's outputs.

    position: outputs that make one distance, of `unit` [SI]; turns: outputs that are angles, or,
    if `small`, the turns 2 tan(theta/2) u from a measured to the computed orientation, by names.
    station: where the instrument stands, if anything says so; points: of how many points of an
    image these are the pixels, whose distances count by their root mean square.
    """

    instrument: str
    station: str | None
    form: str
    position: tuple[str, ...]
    unit: str
    turns: tuple[str, ...]
    small: bool = False
    points: int = 1

    @property
    def image(self) -> bool:
        """Whether these are pixels."""
        return self.form == PIXELS


def seen_outputs(mechanism: Mechanism) -> tuple[Seen, ...]:
    """The outputs by instrument; those of a loop without instruments count together."""
    return tuple(one for family in _families(mechanism) for one in _seen(mechanism, family))


def distance_unit(mechanism: Mechanism) -> str:
    """SI unit of the distances between computed and measured outputs: of positions where any is
    seen, else of angles."""
    seen = seen_outputs(mechanism)
    units = [one.unit for one in seen if one.position]
    return "m" if "m" in units or not seen else units[0] if units else "rad"


def _seen(mechanism: Mechanism, family: Family) -> Iterator[Seen]:
    outputs = [q for q in family.readings if q in mechanism.outputs]
    station = _station(family)
    if gaps := [q for q in family.readings if q in mechanism.gaps]:
        lengths, turns = (
            tuple(q for q in gaps if mechanism.quantities[q] == si) for si in ("m", "rad")
        )
        yield Seen(family.name, None, family.form, lengths, "m", turns, bool(turns))
    if not outputs:
        return
    small = [q for q in mechanism.turns if q in family.readings]
    if family.form in POLAR:
        yield Seen(family.name, station, family.form, tuple(outputs), "m", ())
        return
    units = {mechanism.quantities[q] for q in outputs}
    angles = [q for q in outputs if mechanism.quantities[q] == "rad"]
    unit = "m" if "m" in units else min(units - {"rad"}, default="")
    if len(units - {"m", "rad"}) > 1:
        return  # nothing that could be added up
    position = tuple(q for q in outputs if mechanism.quantities[q] == unit)
    turns = tuple(small or angles)
    count = _points(family, len(position))
    yield Seen(family.name, station, family.form, position, unit, turns, bool(small), count)


@dataclass(frozen=True)
class OutputGroup:
    """Outputs of one unit [SI] that one instrument reads: positions, or angles."""

    instrument: str
    station: str | None
    unit: str
    outputs: tuple[str, ...]
    rows: tuple[int, ...]
    """Their positions among all outputs."""
    points: int = 1
    """Of how many points of an image these are the pixels."""
    image: bool = False
    """Whether these are pixels."""


def output_groups(mechanism: Mechanism) -> tuple[OutputGroup, ...]:
    """The outputs whose sds belong together; each output is in one group."""
    groups = []
    for family in _families(mechanism):
        outputs = [q for q in family.readings if q in mechanism.outputs]
        for unit in dict.fromkeys(mechanism.quantities[q] for q in outputs):
            alike = tuple(q for q in outputs if mechanism.quantities[q] == unit)
            rows = tuple(mechanism.outputs.index(q) for q in alike)
            points = _points(family, len(alike))
            image = family.form == PIXELS
            station = _station(family)
            groups.append(OutputGroup(family.name, station, unit, alike, rows, points, image))
    return tuple(groups)


def _points(family: Family, coordinates: int) -> int:
    return coordinates // 2 if family.form == PIXELS else 1


def _families(mechanism: Mechanism) -> tuple[Family, ...]:
    """The instruments; a loop without any counts as one."""
    return mechanism.families or (Family("", (), mechanism.outputs, "plain"),)


def _station(family: Family) -> str | None:
    return family.placement.name if isinstance(family.placement, Station) else None


def point_outputs(mechanism: Mechanism, family: Family) -> tuple[str, ...]:
    """The outputs of a family that say where a point is; none where they do not."""
    if family.form not in ("point", "pose", *POLAR):
        return ()
    outputs = [q for q in family.readings if q in mechanism.outputs]
    if family.form == "pose":
        outputs = [q for q in outputs if mechanism.quantities[q] == "m"]
    return tuple(outputs)


def measured_points(mechanism: Mechanism) -> list[tuple[str, ...]]:
    """The outputs of each point that is measured; of an own loop, all that are lengths."""
    if mechanism.families:
        return [point_outputs(mechanism, family) for family in mechanism.families]
    return [tuple(q for q in mechanism.outputs if mechanism.quantities[q] == "m")]


def points(family: Family, readings: Array) -> Array:
    """Cartesian points (d, N) of readings (r, N) of the outputs that say where a point is."""
    return cartesian(readings) if family.form in POLAR else readings


def point_family(mechanism: Mechanism) -> Family | None:
    """The instrument that measures where a point is; one whose place is known, if there is any."""
    measuring = [family for family in mechanism.families if point_outputs(mechanism, family)]
    # False sorts first: an instrument without a station reads in the machine's base.
    return min(measuring, key=lambda family: family.placement is not None, default=None)


def levers(family: Family, readings: Array) -> Array:
    """(r, N) how far a point moves by each of its readings (r, N): 1, or [m/rad] for angles."""
    if family.form not in POLAR:
        return np.ones_like(readings)
    # An azimuth swings the point on a circle of radius range * cos(elevation).
    flat = np.cos(readings[2]) if len(readings) == 3 else 1.0
    return np.array([np.ones_like(readings[0]), readings[0] * flat, readings[0]][: len(readings)])


def cartesian(readings: Array) -> Array:
    """x, y, z (3, N) of range, azimuth and elevation (3, N), the azimuth from x towards y.

    In a plane x, y (2, N) of range and azimuth.
    """
    distance, azimuth = readings[:2]
    if len(readings) == 2:
        return np.array([distance * np.cos(azimuth), distance * np.sin(azimuth)])
    level = distance * np.cos(readings[2])
    height = distance * np.sin(readings[2])
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])


def cartesian_slopes(polar: Array) -> Array:
    """Derivatives (N, d, d) of coordinates by range, azimuth and elevation (d, N)."""
    r, a = polar[0], polar[1]
    e = polar[2] if len(polar) == 3 else np.zeros_like(r)
    ca, sa, ce, se = np.cos(a), np.sin(a), np.cos(e), np.sin(e)
    zero = np.zeros_like(r)
    whole = np.array(
        [
            [ce * ca, -r * ce * sa, -r * se * ca],
            [ce * sa, r * ce * ca, -r * se * sa],
            [se, zero, r * ce],
        ]
    )
    d = len(polar)
    return np.moveaxis(whole[:d, :d], 2, 0)
