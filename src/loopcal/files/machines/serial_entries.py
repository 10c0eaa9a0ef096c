"""Serial arms as mechanism files describe them: joints, base, tool, and instruments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.machines.instrument_entries import instruments
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.motoman import motoman_ma1400
from loopcal.mechanisms.serial import (
    Joint,
    base_names,
    parameter_keys,
    serial_arm,
    serial_machine,
    tool_names,
)
from loopcal.mechanisms.serial import parameter_name as serial_name

if TYPE_CHECKING:
    from loopcal.files.machines.mechanism_parts import Value
    from loopcal.files.machines.mechanism_schema import BasePlacement, JointEntry, Motoman, Serial


def serial(model: Serial, units: Mapping[str, str], place: Place) -> Mechanism:
    """The arm of a table of the type "serial".

    Raises InputError at the joint, key or value that does not fit.
    """
    _refuse_repeated([joint.name for joint in model.joint], model.point, place)
    joints, nominal = [], {}
    for i, entry in enumerate(model.joint):
        here = place.at("joint", i)
        joints.append(_joint(entry, units, here))
        keys = parameter_keys(entry.form)
        for key, value in entry.nominal().items():
            if key not in keys:
                raise InputError(
                    f"a joint of the form {entry.form!r} has no {key!r}",
                    place=str(here.at(key)),
                    remedy=f"its nominal values are {', '.join(keys)}",
                )
            si = "rad" if key in ("alpha", "beta", "offset") or key.startswith("phi") else "m"
            nominal[serial_name(entry.form, key, i + 1)] = _si(value, si, units, here.at(key))
    tool = dict(zip("xyz", tool_names(joints), strict=True))
    for axis, name in tool.items():
        given = getattr(model.tool, axis)
        if given is not None:
            nominal[name] = _si(given, "m", units, place.at("tool", axis))
    if model.instrument is not None:
        return _looked_at(model, joints, nominal, units, place)
    base = model.base if isinstance(model.base, bool | None) else True
    if not isinstance(model.base, bool | None):
        nominal |= _base(model.base, units, place.at("base"))
    x, y, z = model.point
    try:
        return serial_arm(joints, nominal, base=base, point=(x, y, z), name=model.name)
    except InputError as error:
        raise error.at(str(place)) from None


def _looked_at(
    model: Serial,
    joints: list[Joint],
    nominal: dict[str, float],
    units: Mapping[str, str],
    place: Place,
) -> Mechanism:
    """The arm with the instruments that its file lists."""
    for key in ("base", "point"):
        if key in model.model_fields_set:
            raise InputError(
                f"{key!r} describes the one instrument of a file that lists none",
                place=str(place.at(key)),
                remedy="give it to an instrument (station, readings), with nominal values in "
                "[parameters]",
            )
    machine = serial_machine(joints, name=model.name)
    looking = instruments(model.instrument or [], machine, units, place.at("instrument"))
    return assemble(machine, looking, nominal)


def _base(given: BasePlacement, units: Mapping[str, str], place: Place) -> dict[str, float]:
    found = {}
    for name in base_names():
        key = name.removeprefix("base_")
        value = getattr(given, key)
        if value is not None:
            found[name] = _si(value, "rad" if key.startswith("r") else "m", units, place.at(key))
    return found


def _joint(entry: JointEntry, units: Mapping[str, str], place: Place) -> Joint:
    return Joint(
        entry.name,
        entry.form,
        entry.kind,
        entry.direction,
        motions(entry.before, units, place.at("before")),
        motions(entry.after, units, place.at("after")),
    )


def motoman(model: Motoman, units: Mapping[str, str], place: Place) -> Mechanism:
    """The arm of a table of the type "motoman-ma1400"."""
    before = motions(model.before, units, place.at("before"))
    return motoman_ma1400(before=before, name=model.name)


def motions(given: Mapping[Any, Value], units: Mapping[str, str], place: Place) -> dict[str, float]:
    """Fixed motions by their names, SI."""
    return {
        motion: _si(value, "m" if motion[0] == "t" else "rad", units, place.at(motion))
        for motion, value in given.items()
    }


def _si(value: Value, si: str, units: Mapping[str, str], place: Place) -> float:
    number = in_si(value.value, value.unit, si, place, units)
    if not math.isfinite(number):
        raise InputError(f"{value.value!r} is given", place=str(place), remedy="give less")
    return number


def _refuse_repeated(joints: list[str], point: list[str], place: Place) -> None:
    seen: set[str] = set()
    for i, name in enumerate([*joints, *point]):
        if name in seen:
            here = place.at("joint", i, "name") if i < len(joints) else place.at("point")
            raise InputError(
                f"{name!r} names two quantities", place=str(here), remedy="name each differently"
            )
        seen.add(name)
