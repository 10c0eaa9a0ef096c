"""A machine looked at in further points of its body, as if one more instrument read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_table
from loopcal.files.machines.registry import machine_type
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.station import Station

_OF_POINT = ("base", "point", "tool", "before", "station")
"""Keys of an arm's own point, which a listed instrument states otherwise."""
Point = Sequence[float] | Sequence[str]
"""Coordinates [m] in the frame of the body, or the names of the parameters that hold them."""


def with_points(
    mechanism: Mechanism, points: Mapping[str, Point], station: str | None
) -> Mechanism:
    """The mechanism with outputs NAME_x, NAME_y, NAME_z [m] of points of its body alone.

    Effects and the structured model error act on them as on what was measured. Its parameters have
    their names and values.

    station: of an instrument, whose frame the coordinates are in; None:
    the first frame of the chain. Raises InputError for a machine that no file describes.
    """
    data = mechanism_table(mechanism)
    # Of a limb the description has all bodies of the robot.
    tree = mechanism.tree if mechanism.chain and "body" in data else None
    if data["type"] == "function":
        raise InputError(
            f"{mechanism.name!r} is written as a function, so points of its body are unknown",
            code="unsupported",
            remedy="describe the arm in a mechanism file, as type = 'serial' or 'urdf'",
        )
    if "instrument" not in data:
        data = _listed(data, mechanism)
    for name, point in points.items():
        readings = [f"{name}_{axis}" for axis in "xyz"]
        named = [v for v in point if isinstance(v, str)]
        numbers = [v for v in point if not isinstance(v, str)]
        target = named or [f"{name}:{axis}" for axis in "xyz"]
        data["instrument"].append(
            {
                "type": "point",
                "name": name,
                "readings": readings,
                "station": False if station is None else station,
                "target": target,
                **({"on": tree.leaves[0]} if tree else {}),
            }
        )
        if not named:
            data["parameters"] |= {
                n: {"value": float(v), "unit": "m", "fixed": True}
                for n, v in zip(target, numbers, strict=True)
            }
    # with several instruments its own chain would no longer say where the arm stands
    chain = mechanism.placement if isinstance(mechanism.placement, ChainPlacement) else None
    return mechanism_from_data(data, mechanism.name, placement=chain)


def _listed(data: Mapping[str, Any], mechanism: Mechanism) -> dict[str, Any]:
    """The same arm with its one instrument listed, which its type has by itself."""
    (family,) = mechanism.families
    kept = {k: v for k, v in data.items() if k not in _OF_POINT}
    if joints := machine_type(data["type"]).listed():
        joints[0]["before"] = data.get("before", {})
        kept["joint"] = joints
    seen = {
        "type": "point",
        "readings": list(family.readings),
        "station": family.placement.name if isinstance(family.placement, Station) else False,
        "target": list(family.mounted),
    }
    return {**kept, "type": "serial", "fix_redundant": False, "instrument": [seen]}
