"""Mechanisms of the type "function": what a file declares of loops written in Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from loopcal.errors import InputError, placed
from loopcal.files.machines.attached import affected, needed
from loopcal.files.machines.machine_type import MechanismTable
from loopcal.files.machines.parameter_entries import (
    Home,
    by_dimension,
    changed,
    declared_parameters,
    home_in_si,
)
from loopcal.files.machines.python_function import Loops
from loopcal.files.toml.place import Place, Scope
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit


@dataclass(frozen=True)
class Function(MechanismTable):
    """What is read and what is constant in loops written as a Python function f(x, p).

    The function itself is named where the project is used: --mechanism FILE.py:FUNCTION.
    """

    name: Annotated[str | None, Key("Name of the machine.")] = None
    quantities: Annotated[
        Mapping[str, str], Key("What is read in each pose, and its unit.", is_unit=True)
    ] = field(default_factory=dict)
    known: Annotated[
        Mapping[str, str],
        Key("Constants that vary by pose and carry no error, and their unit.", is_unit=True),
    ] = field(default_factory=dict)
    outputs: Annotated[
        tuple[str, ...], Key("The quantities that the loops predict from the rest.")
    ] = ()
    loops: Annotated[tuple[str, ...] | None, Key("Names of the equations.")] = None
    home: Home = field(default_factory=dict)


def declared_function(
    model: Function,
    function: Loops | Mechanism | None,
    parameters: Mapping[str, Any],
    place: Place,
) -> Mechanism:
    """The mechanism of a function with its effects, whose parameters are not the function's.

    function: the loops f(x, p), or the mechanism made of them; parameters: those of a project.
    Raises InputError where there is none, or one that is not what is declared.
    """
    mechanism = function if isinstance(function, Mechanism) else None
    entries = [e for e in model.effect if mechanism is None or e.name not in mechanism.effects]
    if not entries:
        return _function(model, function, parameters, place)
    units, effect_place = by_dimension(model.units), place.at("effect")
    scope = Scope(units)
    names = needed(
        mechanism or _function(model, function, parameters, place), entries, scope, effect_place
    )
    plain: dict[str, Any] = {
        "parameters": {n: e for n, e in model.parameters.items() if n not in names},
        "known": {n: u for n, u in model.known.items() if mechanism is None or n not in names},
    }
    others = {n: e for n, e in parameters.items() if n not in names}
    made = _function(replace(model, **plain), function, others, place)
    made = affected(made, entries, scope, effect_place)
    stated = {n: e for n, e in model.parameters.items() if n in names}
    return made.with_parameters(changed(made.parameters, stated, place.at("parameters"), units))


def _function(
    model: Function,
    function: Loops | Mechanism | None,
    parameters: Mapping[str, Any],
    place: Place,
) -> Mechanism:
    if function is None:
        raise InputError(
            "the loops of this mechanism are a Python function, but no function is named",
            code="missing-key",
            place=str(place),
            remedy="name it on the command line: --mechanism FILE.py:FUNCTION",
        )
    units, parameters_place = by_dimension(model.units), place.at("parameters")
    if isinstance(function, Mechanism):
        _refuse_other_quantities(model, function, place)
        home = home_in_si(model.home, function.quantities, place.at("home"), units)
        return replace(function, home={**function.home, **home}).with_parameters(
            changed(function.parameters, model.parameters, parameters_place, units)
        )
    if not model.quantities:
        raise InputError(
            "no quantity is declared",
            code="missing-key",
            place=str(place),
            remedy='list what is read in each pose: quantities = { x = "m", theta = "rad" }',
        )
    declared = declared_parameters(model.parameters, parameters_place)
    elsewhere = {n: e for n, e in parameters.items() if n not in declared}
    declared |= declared_parameters(elsewhere, Place(place.file, ("parameters",)))
    with placed(place):
        made = Mechanism.from_function(
            function,
            model.quantities,
            declared,
            model.outputs,
            pose_constants=model.known,
            loops=model.loops,
            name=model.name,
            home=home_in_si(model.home, model.quantities, place.at("home"), units),
        )
    return made.with_parameters(changed(made.parameters, model.parameters, parameters_place, units))


def _refuse_other_quantities(model: Function, mechanism: Mechanism, place: Place) -> None:
    for key, declared, units in (
        ("quantities", model.quantities, mechanism.quantities),
        ("known", model.known, mechanism.pose_constants),
    ):
        stated = {name: unit(u).si for name, u in declared.items()}
        for name in stated:
            if stated[name] != units.get(name):
                counterpart = f"{name!r} in {units[name]}" if name in units else f"no {name!r}"
                raise InputError(
                    f"{name!r} is declared in {stated[name]}, but the named mechanism has it in "
                    f"{counterpart}",
                    code="wrong-unit",
                    place=str(place.at(key, name)),
                    remedy="declare it in only one of them",
                )
