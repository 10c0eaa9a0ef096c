"""The [[instrument]] tables of a mechanism file as instruments that look at a machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.place import Place
from loopcal.mechanisms.instruments.point import AXES, point
from loopcal.mechanisms.machine import Instrument, Machine
from loopcal.mechanisms.station import Target

if TYPE_CHECKING:
    from loopcal.files.instrument_schema import AnyInstrument, PointInstrument


def instruments(
    entries: Sequence[AnyInstrument], machine: Machine, units: Mapping[str, str], place: Place
) -> list[Instrument]:
    """The instruments of these tables, to look at a machine.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    made = []
    for i, entry in enumerate(entries):
        try:
            made.append(_MAKERS[entry.type](entry, machine, units))
        except InputError as error:
            raise error.at(str(place.at(i))) from None
    return made


def _point(entry: PointInstrument, machine: Machine, units: Mapping[str, str]) -> Instrument:
    return point(
        entry.name,
        readings=entry.readings or AXES[: machine.dimension],
        station=entry.station or None,
        target=entry.target if isinstance(entry.target, str) else Target(tuple(entry.target)),
        dimension=machine.dimension,
    )


_MAKERS: dict[str, Callable[[Any, Machine, Mapping[str, str]], Instrument]] = {"point": _point}
