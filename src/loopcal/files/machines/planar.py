"""Arms that are given by their names in mechanism files: the planar two-link, and the MA1400."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import ArmTable, MachineTable, MachineType, looked_at
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.tables import built
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import (
    NAME,
    motoman_joints,
    motoman_ma1400,
    planar_machine,
    planar_two_link,
)


@dataclass(frozen=True)
class PlanarTable(MachineTable):
    """The planar two-link arm: xA, yA, l2, l3, phi20, phi30; reads xP, yP, phi2, phi3.

    With instruments of its own it is the links alone, l2, l3, phi20, phi30, and reads phi2, phi3.
    """

    name: Annotated[str, Key("Name of the machine.")] = NAME
    instrument: Annotated[Instruments | None, Key("What is read of the machine's body.")] = None


def planar(stated: PlanarTable, _: Any, scope: Scope, place: Place) -> Mechanism:
    """The arm of a table of the type "planar-two-link"."""
    if stated.instrument is None:
        return planar_two_link(name=stated.name)
    return looked_at(planar_machine(name=stated.name), stated.instrument, scope, place)


def motoman(_: ArmTable, entry: Any, scope: Scope, place: Place) -> Mechanism:
    """The arm of a table of the type "motoman-ma1400"."""
    made: Mechanism = built(motoman_ma1400, entry, scope, place)
    return made


TYPES = {
    "planar-two-link": MachineType(planar_two_link, PlanarTable, planar),
    "motoman-ma1400": MachineType(motoman_ma1400, ArmTable, motoman, motoman_joints),
}
