"""Parallel machines in mechanism files: the keys of each are the arguments of what makes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pydantic import Field

from loopcal.files.machines.entries import given, table
from loopcal.files.machines.instruments import Instruments
from loopcal.files.machines.machine_type import MachineModel, MachineType, looked_at
from loopcal.files.machines.mechanism_parts import Amount
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.registry import PARALLEL


class ParallelModel(MachineModel):
    """What all parallel machines have; their geometry is in their parameters."""

    home: dict[str, Amount] = Field(
        default={},
        description="Usual values of unread quantities, at which the search for them begins.",
        examples=[{"platform_z": {"value": 700, "unit": "mm"}}],
    )
    instrument: Instruments = Field(default=[])


def _parallel(
    make: Callable[..., Machine], model: Any, units: Mapping[str, str], place: Place
) -> Mechanism:
    options = given(make, model, units, place)
    there = make(**options).quantities
    home = {
        name: in_si(amount.value, amount.unit, there[name], place.at("home", name), units)
        if name in there
        else amount.value
        for name, amount in model.home.items()
    }
    return looked_at(make(**options, home=home), model.instrument, units, place)


TYPES = {
    kind: MachineType(table(make, "Machine", ParallelModel), partial(_parallel, make))
    for kind, make in PARALLEL.items()
}
