"""Mechanisms of the type "function": what a file declares of loops written in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from loopcal.errors import InputError
from loopcal.files.machines.effects import affected, needed
from loopcal.files.machines.machine_type import MechanismModel
from loopcal.files.machines.parameter_entries import changed, declared_here
from loopcal.files.machines.python_function import Loops
from loopcal.files.toml.model import UnitName
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit


class Function(MechanismModel):
    """What is read and what is constant in loops written as a Python function f(x, p).

    The function itself is named where the project is used: --mechanism FILE.py:FUNCTION.
    """

    type: Literal["function"]
    name: str | None = None
    quantities: dict[str, UnitName] = Field(
        default={}, description="What is read in each pose, and its unit."
    )
    known: dict[str, UnitName] = Field(
        default={}, description="Constants that vary by pose and carry no error, and their unit."
    )
    outputs: list[str] = Field(
        default=[], description="The quantities that the loops predict from the rest."
    )
    loops: list[str] | None = Field(default=None, description="Names of the equations.")


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
            "the loops of this mechanism are a Python function, but no function is named",
            code="missing-key",
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
            code="missing-key",
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
                    f"{name!r} is declared in {stated[name]}, but the named mechanism has it in "
                    f"{its_own}",
                    code="wrong-unit",
                    place=str(place.at(key, name)),
                    remedy="declare it in only one of them",
                )
