"""All formats of an export, by name."""

from __future__ import annotations

from loopcal.companions.robot.exports import (
    cameras,
    geometry_json,
    simulators,
    tables,
    tf,
    ur,
    urdf,
    xacro,
)
from loopcal.companions.robot.exports.format import Format
from loopcal.errors import unknown_name

EXPORTS: dict[str, Format] = {
    one.name: one
    for module in (urdf, xacro, ur, tf, tables, simulators, geometry_json, cameras)
    for one in module.FORMATS
}


def format_named(name: str) -> Format:
    """The format of a name. Raises InputError for one that does not exist."""
    if name not in EXPORTS:
        raise unknown_name(f"there is no export format {name!r}", name, EXPORTS)
    return EXPORTS[name]
