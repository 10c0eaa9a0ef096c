"""The table of a machine that is given by its name: the arm Motoman MA1400."""

from __future__ import annotations

from typing import Any

from loopcal.files.machines.machine_type import ArmTable, MachineType
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.tables import built
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import motoman_joints, motoman_ma1400


def motoman(_: ArmTable, entry: Any, scope: Scope, place: Place) -> Mechanism:
    """The arm of a table of the type "motoman-ma1400"."""
    made: Mechanism = built(motoman_ma1400, entry, scope, place)
    return made


TYPES = {"motoman-ma1400": MachineType(motoman_ma1400, ArmTable, motoman, motoman_joints)}
