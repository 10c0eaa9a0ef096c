"""Mechanism files (TOML): a machine's joints or loops, its nominal values, and how sure these are.

A file states `schema = 1` and a `type`; every number may carry a unit of its own, numbers without
one are in the file's `units`, and without these in SI (m, rad). `mechanism_writer` writes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, nearest
from loopcal.files.parameter_entries import changed, declared_here, in_si
from loopcal.files.place import Place
from loopcal.files.toml_reader import checked_schema, read_toml, shown
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.motoman import motoman_ma1400
from loopcal.mechanisms.planar import planar_two_link
from loopcal.mechanisms.serial import Joint, base_names, parameter_keys, serial_arm, tool_names
from loopcal.mechanisms.serial import parameter_name as serial_name
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.mechanism_schema import Function, JointEntry, Motoman, Serial, Value

Loops = Callable[..., Iterable[Any]]
"""A function f(x, p) of loop equations."""


def read_mechanism(path: str | Path, *, function: Loops | Mechanism | None = None) -> Mechanism:
    """The mechanism of a file.

    function: for a file of the type "function", which declares everything but the code: the
    loops f(x, p), or the mechanism made of them, whose values the file then replaces.

    Raises InputError, naming file and key, for all that cannot be read or does not fit.
    """
    data = read_toml(path)
    place = Place(shown(path))
    checked_schema(data, place)
    return mechanism_from_data(
        {key: value for key, value in data.items() if key != "schema"}, place, function=function
    )


def read_arm(path: str | Path) -> Mechanism | None:
    """The mechanism of a file that says all of it; None of one whose loops are Python code.

    Raises InputError as `read_mechanism` does.
    """
    return None if read_toml(path).get("type") == "function" else read_mechanism(path)


def mechanism_from_data(
    data: Mapping[str, Any],
    place: Place | str,
    *,
    function: Loops | Mechanism | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> Mechanism:
    """The mechanism that a table describes, without its schema.

    place: the file (and key) it stands at, for messages; parameters: a project's [parameters],
    in which a mechanism of the type "function" may declare its own.

    Raises InputError as `read_mechanism` does.
    """
    from loopcal.files import mechanism_schema as schema
    from loopcal.files.model import validated

    place = Place(place) if isinstance(place, str) else place
    kind = data.get("type")
    if not isinstance(kind, str) or kind not in schema.TYPES:
        raise InputError(
            "the mechanism's type is missing" if kind is None else f"there is no type {kind!r}",
            place=str(place if kind is None else place.at("type")),
            remedy=nearest(str(kind or ""), schema.TYPES),
        )
    model = validated(schema.TYPES[kind], dict(data), place)
    if isinstance(model, schema.Function):
        return _function(model, function, parameters or {}, place)
    if function is not None:
        raise InputError(
            f"this describes a mechanism of the type {kind!r}, and a function is named as well",
            place=str(place),
            remedy='leave the function out, or describe the mechanism as type = "function"',
        )
    units = model.units.by_dimension()
    if isinstance(model, schema.Serial):
        made = _serial(model, units, place)
    elif isinstance(model, schema.Motoman):
        made = _motoman(model, units, place)
    else:
        made = planar_two_link(name=model.name)
    entries = changed(made.parameters, model.parameters, place.at("parameters"), units)
    return made.with_parameters(entries)


def _serial(model: Serial, units: Mapping[str, str], place: Place) -> Mechanism:
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
    base = model.base if isinstance(model.base, bool | None) else True
    if not isinstance(model.base, bool | None):
        for name in base_names():
            key = name.removeprefix("base_")
            given = getattr(model.base, key)
            if given is not None:
                si = "rad" if key.startswith("r") else "m"
                nominal[name] = _si(given, si, units, place.at("base", key))
    x, y, z = model.point
    try:
        return serial_arm(joints, nominal, base=base, point=(x, y, z), name=model.name)
    except InputError as error:
        raise error.at(str(place)) from None


def _joint(entry: JointEntry, units: Mapping[str, str], place: Place) -> Joint:
    return Joint(
        entry.name,
        entry.form,
        entry.kind,
        entry.direction,
        _motions(entry.before, units, place.at("before")),
        _motions(entry.after, units, place.at("after")),
    )


def _motoman(model: Motoman, units: Mapping[str, str], place: Place) -> Mechanism:
    before = _motions(model.before, units, place.at("before"))
    return motoman_ma1400(before=before, name=model.name)


def _motions(
    given: Mapping[Any, Value], units: Mapping[str, str], place: Place
) -> dict[str, float]:
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


def _function(
    model: Function,
    function: Loops | Mechanism | None,
    parameters: Mapping[str, Any],
    place: Place,
) -> Mechanism:
    if function is None:
        raise InputError(
            "the loops of this mechanism are a Python function, and none is named",
            place=str(place),
            remedy="name it on the command line: --mechanism FILE.py:FUNCTION",
        )
    units, here = model.units.by_dimension(), place.at("parameters")
    if isinstance(function, Mechanism):
        _refuse_other_quantities(model, function, place)
        return function.with_parameters(changed(function.parameters, model.parameters, here, units))
    if not model.quantities:
        raise InputError(
            "no quantity is declared",
            place=str(place),
            remedy='list what is read in each pose: quantities = { x = "m", theta = "rad" }',
        )
    declared = declared_here(model.parameters, here)
    elsewhere = {n: e for n, e in parameters.items() if n not in declared}
    declared |= declared_here(elsewhere, Place(place.file, ("parameters",)))
    try:
        made = Mechanism.from_function(
            function,
            model.quantities,
            declared,
            model.outputs,
            known=model.known,
            loops=model.loops,
            name=model.name,
        )
    except InputError as error:
        raise error.at(str(place)) from None
    return made.with_parameters(changed(made.parameters, model.parameters, here, units))


def _refuse_other_quantities(model: Function, mechanism: Mechanism, place: Place) -> None:
    for key in ("quantities", "known"):
        stated = {name: unit(u).si for name, u in getattr(model, key).items()}
        its = dict(getattr(mechanism, key))
        for name in stated:
            if stated[name] != its.get(name):
                its_own = f"{name!r} in {its[name]}" if name in its else f"no {name!r}"
                raise InputError(
                    f"{name!r} is declared in {stated[name]}, the mechanism named has {its_own}",
                    place=str(place.at(key, name)),
                    remedy="leave the declaration to one of both",
                )
