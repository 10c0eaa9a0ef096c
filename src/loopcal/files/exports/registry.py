"""All formats of an export, by name."""

from __future__ import annotations

from loopcal.errors import unknown_name
from loopcal.files.exports import geometry_json, simulators, tables, tf, ur, urdf, xacro
from loopcal.files.exports.format import Format

EXPORTS: dict[str, Format] = {
    one.name: one
    for module in (urdf, xacro, ur, tf, tables, simulators, geometry_json)
    for one in module.FORMATS
}


def format_named(name: str) -> Format:
    """The format of a name. Raises InputError for one that does not exist."""
    if name not in EXPORTS:
        raise unknown_name(f"there is no export format {name!r}", name, EXPORTS)
    return EXPORTS[name]
