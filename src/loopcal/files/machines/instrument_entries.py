"""The [[instrument]] tables of a mechanism file as instruments that look at a machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.toml.place import Place
from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import Instrument, Machine
from loopcal.mechanisms.station import Target

if TYPE_CHECKING:
    from loopcal.files.machines import instrument_schema as schema


def instruments(
    entries: Sequence[schema.AnyInstrument],
    machine: Machine,
    units: Mapping[str, str],
    place: Place,
) -> list[Instrument]:
    """The instruments of these tables, to look at a machine.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    made = []
    for i, entry in enumerate(entries):
        try:
            target = entry.target
            looked_at = target if isinstance(target, str) else Target(tuple(target))
            made.append(MAKERS[entry.type](entry, looked_at, machine))
        except InputError as error:
            raise error.at(str(place.at(i))) from None
    return made


def _point(entry: schema.PointInstrument, target: Any, machine: Machine) -> Instrument:
    return point(
        entry.name,
        readings=entry.readings,
        station=entry.station or None,
        target=target,
        dimension=machine.dimension,
    )


def _pose(entry: schema.PoseInstrument, target: Any, machine: Machine) -> Instrument:
    return pose(
        entry.name,
        readings=entry.readings,
        turns=entry.turns,
        orientation=entry.orientation,
        columns=entry.columns,
        station=entry.station or None,
        target=target,
        dimension=machine.dimension,
    )


def _plainly(maker: Callable[..., Instrument]) -> Callable[..., Instrument]:
    """A maker whose arguments are the keys of its table."""

    def made(entry: schema.AnyInstrument, target: Any, machine: Machine) -> Instrument:
        given = {key: getattr(entry, key) for key in type(entry).model_fields}
        given |= {"target": target, "dimension": machine.dimension}
        return maker(**{key: value for key, value in given.items() if key != "type"})

    return made


MAKERS: dict[str, Callable[[Any, Any, Machine], Instrument]] = {
    "point": _point,
    "pose": _pose,
    "spherical": _plainly(spherical),
    "distance": _plainly(distance),
    "draw-wire": _plainly(draw_wire),
    "relative-distance": _plainly(relative_distance),
    "ball-bar": _plainly(ball_bar),
    "sphere": _plainly(sphere),
    "plane": _plainly(plane),
    "socket": _plainly(socket),
}
"""By type, what makes the instrument of a table."""
