"""Mechanism files (TOML): a machine's joints or loops, its nominal values, and how sure these are.

A file states `schema = 1` and a `type`; every number may carry a unit of its own, numbers without
one are in the file's `units`, and without these in SI (m, rad). `mechanism_writer` writes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, nearest
from loopcal.files.machines.chain_entries import exponential, urdf
from loopcal.files.machines.effect_entries import affected, needed
from loopcal.files.machines.identifiable import Told, identifiable
from loopcal.files.machines.instrument_entries import instruments as listed
from loopcal.files.machines.parallel_entries import MAKERS, parallel
from loopcal.files.machines.parameter_entries import changed, declared_here
from loopcal.files.machines.serial_entries import motoman, serial
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.planar import planar_machine, planar_two_link
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.machines.mechanism_schema import Function, PlanarTwoLink

Loops = Callable[..., Iterable[Any]]
"""A function f(x, p) of loop equations."""


def read_mechanism(
    path: str | Path,
    *,
    function: Loops | Mechanism | None = None,
    instruments: Sequence[Mapping[str, Any]] | None = None,
    effects: Sequence[Mapping[str, Any]] | None = None,
    told: Told | None = None,
) -> Mechanism:
    """The mechanism of a file.

    function: for a file of the type "function", which declares everything but the code: the
    loops f(x, p), or the mechanism made of them, whose values the file then replaces;
    instruments, effects: [[instrument]] and [[effect]] tables in place of the file's own; told:
    as in `mechanism_from_data`.

    Raises InputError, naming file and key, for all that cannot be read or does not fit.
    """
    data = read_toml(path)
    place = Place(shown(path))
    checked_schema(data, place)
    stated = {key: value for key, value in data.items() if key != "schema"}
    if instruments is not None:
        stated["instrument"] = list(instruments)
    if effects is not None:
        stated["effect"] = list(effects)
    return mechanism_from_data(stated, place, function=function, told=told)


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
    told: Told | None = None,
) -> Mechanism:
    """The mechanism that a table describes, without its schema.

    place: the file (and key) it stands at, for messages; parameters: a project's [parameters],
    in which a mechanism of the type "function" may declare its own; told: what a project will say
    of the parameters, around which those of a chain are chosen that are fixed.

    Raises InputError as `read_mechanism` does.
    """
    from loopcal.files.machines import mechanism_schema as schema
    from loopcal.files.machines.chain_schema import ChainModel
    from loopcal.files.toml.model import validated

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
        return _affected_function(model, function, parameters or {}, place)
    if function is not None:
        raise InputError(
            f"this describes a mechanism of the type {kind!r}, and a function is named as well",
            place=str(place),
            remedy='leave the function out, or describe the mechanism as type = "function"',
        )
    units = model.units.by_dimension()
    try:
        made = BUILDERS[kind](model, units, place)
    except InputError as error:
        raise error if error.place else error.at(str(place)) from None
    made = affected(made, model.effect, units, place.at("effect"))

    def stated(parameters: Parameters) -> Parameters:
        return changed(parameters, model.parameters, place.at("parameters"), units)

    if isinstance(model, ChainModel):
        made = replace(made, remarks=tuple(model.remarks))
        if model.fix_redundant:
            made = identifiable(made, lambda p: stated(p) if told is None else told(stated(p)))
    return made.with_parameters(stated(made.parameters))


def _planar(model: PlanarTwoLink, units: Mapping[str, str], place: Place) -> Mechanism:
    if model.instrument is None:
        return planar_two_link(name=model.name)
    machine = planar_machine(name=model.name)
    return assemble(machine, listed(model.instrument, machine, units, place.at("instrument")))


BUILDERS: dict[str, Callable[[Any, Mapping[str, str], Place], Mechanism]] = {
    "planar-two-link": _planar,
    "serial": serial,
    "urdf": urdf,
    "exponentials": exponential,
    "motoman-ma1400": motoman,
    **dict.fromkeys(MAKERS, parallel),
}
"""By type, what makes a mechanism of the model of its table."""


def _affected_function(
    model: Function,
    function: Loops | Mechanism | None,
    parameters: Mapping[str, Any],
    place: Place,
) -> Mechanism:
    """The mechanism of a function with its effects, whose parameters are not the function's."""
    there = function if isinstance(function, Mechanism) else None
    entries = [e for e in model.effect if there is None or e.name not in there.effects]
    if not entries:
        return _function(model, function, parameters, place)
    units, here = model.units.by_dimension(), place.at("effect")
    own = needed(there or _function(model, function, parameters, place), entries, units, here)
    plain = {
        "parameters": {n: e for n, e in model.parameters.items() if n not in own},
        "known": {n: u for n, u in model.known.items() if there is None or n not in own},
    }
    others = {n: e for n, e in parameters.items() if n not in own}
    made = _function(model.model_copy(update=plain), function, others, place)
    made = affected(made, entries, units, here)
    stated = {n: e for n, e in model.parameters.items() if n in own}
    return made.with_parameters(changed(made.parameters, stated, place.at("parameters"), units))


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
