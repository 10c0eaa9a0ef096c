"""The types of mechanism files, one row each; what belongs to a type is loaded when it is named."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from loopcal.files.machines.machine_type import MachineType
from loopcal.files.toml.tables import table

_HOME = {
    "planar-two-link": "planar",
    "serial": "serial",
    "urdf": "chains",
    "exponentials": "chains",
    "tree": "trees",
    "motoman-ma1400": "planar",
}
"""By type, the module here whose `TYPES` holds it; all others are parallel machines."""


def kinds() -> tuple[str, ...]:
    """The names of all types."""
    from loopcal.mechanisms.parallel.registry import PARALLEL

    return (*_HOME, *PARALLEL, "function")


def machine_type(kind: str) -> MachineType:
    """The row of a type other than "function"; raises KeyError for what is no type."""
    home = import_module(f"loopcal.files.machines.{_HOME.get(kind, 'parallel')}")
    row: MachineType = home.TYPES[kind]
    return row


def drawn() -> tuple[str, ...]:
    """The types of arms whose dimensions are part of the type."""
    return tuple(kind for kind in _HOME if machine_type(kind).joints)


def table_of(kind: str) -> type[Any]:
    """The model of a type's table; a function is built elsewhere, for no file holds it.

    Raises KeyError for what is no type.
    """
    if kind != "function":
        row = machine_type(kind)
        return table(row.make, "Machine", row.common)
    from loopcal.files.machines.declared_function import Function

    return table(Function, "Machine")
