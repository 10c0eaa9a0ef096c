"""Parallel machines as mechanism files describe them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from loopcal.files.machines.instrument_entries import instruments
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.linear_delta import linear_delta
from loopcal.mechanisms.parallel.rotary_delta import rotary_delta
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr

if TYPE_CHECKING:
    from loopcal.files.machines.parallel_schema import Delta, PassiveMachine

MAKERS: dict[str, Callable[..., Machine]] = {
    "four-bar": four_bar,
    "five-bar": five_bar,
    "three-rrr": three_rrr,
    "linear-delta": linear_delta,
    "rotary-delta": rotary_delta,
    "stewart-gough": stewart_gough,
}
"""By type, what makes the machine."""


def parallel(model: PassiveMachine | Delta, units: Mapping[str, str], place: Place) -> Mechanism:
    """The mechanism of a table of one of these types.

    Raises InputError at the key that does not fit.
    """
    options: dict[str, Any] = {}
    if model.name is not None:
        options["name"] = model.name
    if "passive" in type(model).model_fields:
        options["passive"] = model.passive  # type: ignore[union-attr]
    maker = MAKERS[model.type]
    there = maker(**options).quantities
    options["home"] = {
        name: in_si(given.value, given.unit, there[name], place.at("home", name), units)
        if name in there
        else given.value
        for name, given in model.home.items()
    }
    machine = maker(**options)
    return assemble(machine, instruments(model.instrument, machine, units, place.at("instrument")))
