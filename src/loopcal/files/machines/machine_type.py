"""A type of machine in mechanism files: what its table may say, and what is built of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from loopcal.errors import InputError
from loopcal.files.machines.effects import Effects
from loopcal.files.machines.entries import table
from loopcal.files.machines.instruments import instruments
from loopcal.files.machines.mechanism_parts import ParameterEntries, Units
from loopcal.files.toml.model import Finite, Model
from loopcal.files.toml.place import Place
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import structured

if TYPE_CHECKING:
    Structure = Any
else:
    Structure = table(structured) | None


class MechanismModel(Model):
    """What mechanisms of all types may say."""

    units: Units = Units()
    effect: Effects = Field(default=[])
    parameters: ParameterEntries = Field(default={})


class MachineModel(MechanismModel):
    """What machines of all types may say."""

    structure: Structure = Field(
        default=None, description="The model error that the machine has beyond geometry."
    )


class ArmModel(MachineModel):
    """What arms of all types may say."""

    gravity: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="Direction in which gravity pulls, in the base of the machine. "
        "Default: [0, 0, -1].",
    )


class ChainModel(ArmModel):
    """What chains of all types may say."""

    fix_redundant: bool = Field(
        default=True,
        description="Whether to fix parameters that are indistinguishable from others, chosen "
        "from the geometry; `loopcal check` reports the reason for each.",
    )
    remarks: list[str] = Field(
        default=[], description="What `loopcal check` reports, such as why a parameter is fixed."
    )


Build = Callable[[Any, Mapping[str, str], Place], Mechanism]


@dataclass(frozen=True)
class MachineType:
    """The table of a type, and what builds the mechanism of it without effects and parameters.

    build(model, units, place): units: dimension -> unit of numbers that state none.
    """

    model: type[MechanismModel]
    build: Build


def looked_at(
    machine: Machine,
    entries: Any,
    units: Mapping[str, str],
    place: Place,
    nominal: Mapping[str, float] | None = None,
) -> Mechanism:
    """The mechanism of a machine and the [[instrument]] entries; None stands for a `point`.

    Raises InputError at the instrument that does not fit.
    """
    here = place.at("instrument")
    looking = [point()] if entries is None else instruments(entries, machine, units, here)
    try:
        return assemble(machine, looking, nominal)
    except InputError as error:
        raise error.at(str(here)) from None
