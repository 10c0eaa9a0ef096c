"""Parallel machines in mechanism files: the keys of each are the arguments of what makes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import MachineTable, MachineType, looked_at
from loopcal.files.machines.parameter_entries import Home, changed, entries_of, home_in_si
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.tables import stated_arguments
from loopcal.keys import Key
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.registry import PARALLEL
from loopcal.mechanisms.parameters import Parameters


@dataclass(frozen=True)
class ParallelTable(MachineTable):
    """What all parallel machines have; their geometry is in their parameters."""

    home: Home = field(default_factory=dict)
    instrument: Annotated[Instruments, Key("What is read of the machine's body.")] = ()


def _parallel(
    make: Callable[..., Machine], stated: ParallelTable, entry: Any, scope: Scope, place: Place
) -> Mechanism:
    options = stated_arguments(make, entry, scope, place)
    home = home_in_si(stated.home, make(**options).quantities, place.at("home"), scope.units)
    machine = make(**options, home=home)
    parameters = Parameters(tuple(machine.parameters.values()))
    entries = entries_of(parameters, stated.parameters)
    drawn = changed(parameters, entries, place.at("parameters"), scope.units)
    nominal = {p.name: p.nominal for p in drawn}
    return looked_at(machine, stated.instrument, scope, place, nominal)


TYPES = {
    kind: MachineType(make, ParallelTable, partial(_parallel, make))
    for kind, make in PARALLEL.items()
}
