"""The types of mechanism files, one row each."""

from __future__ import annotations

from loopcal.files.machines.chains import Exponentials, Urdf, exponential, urdf
from loopcal.files.machines.declared_function import Function
from loopcal.files.machines.entries import table
from loopcal.files.machines.machine_type import MachineType, MechanismModel
from loopcal.files.machines.parallel import machine_type
from loopcal.files.machines.planar import PlanarTwoLink, planar
from loopcal.files.machines.serial import Serial, motoman, serial
from loopcal.mechanisms.motoman import motoman_ma1400
from loopcal.mechanisms.parallel.registry import PARALLEL

MACHINES = {
    "planar-two-link": MachineType(PlanarTwoLink, planar),
    "serial": MachineType(Serial, serial),
    "urdf": MachineType(Urdf, urdf),
    "exponentials": MachineType(Exponentials, exponential),
    "motoman-ma1400": MachineType(table(motoman_ma1400, "Machine", MechanismModel), motoman),
    **{kind: machine_type(make) for kind, make in PARALLEL.items()},
}
"""By the type that files name, the table and what builds the mechanism of it."""

MODELS: dict[str, type[MechanismModel]] = {
    **{kind: row.model for kind, row in MACHINES.items()},
    "function": Function,
}
"""By type, the table; that of a function is built with the function, which no file holds."""
