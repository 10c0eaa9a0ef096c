"""The planar two-link arm in mechanism files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from loopcal.files.machines.instruments import Instruments
from loopcal.files.machines.machine_type import MachineModel, MachineType, looked_at
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import NAME, planar_machine, planar_two_link


class PlanarTwoLink(MachineModel):
    """The planar two-link arm: xA, yA, l2, l3, phi20, phi30; reads xP, yP, phi2, phi3.

    With instruments of its own it is the links alone, l2, l3, phi20, phi30, and reads phi2, phi3.
    """

    type: Literal["planar-two-link"]
    name: str = NAME
    instrument: Instruments | None = None


def planar(model: PlanarTwoLink, units: Mapping[str, str], place: Place) -> Mechanism:
    """The arm of a table of the type "planar-two-link"."""
    if model.instrument is None:
        return planar_two_link(name=model.name)
    return looked_at(planar_machine(name=model.name), model.instrument, units, place)


TYPES = {"planar-two-link": MachineType(PlanarTwoLink, planar)}
