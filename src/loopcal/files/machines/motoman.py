"""The table of a machine that is given by its name: the arm Motoman MA1400."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from loopcal.files.machines.entries import given, table
from loopcal.files.machines.machine_type import ArmModel, MachineType
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.motoman import motoman_ma1400


def motoman(model: Any, units: Mapping[str, str], place: Place) -> Mechanism:
    """The arm of a table of the type "motoman-ma1400"."""
    return motoman_ma1400(**given(motoman_ma1400, model, units, place))


TYPES = {"motoman-ma1400": MachineType(table(motoman_ma1400, "Machine", ArmModel), motoman)}
