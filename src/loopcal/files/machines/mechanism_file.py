"""Mechanism files (TOML): a machine's joints or loops, its nominal values, and how sure these are.

A file states `schema = 1` and a `type`; every number may carry a unit of its own, numbers without
one are in the file's `units`, and without these in SI (m, rad). `mechanism_writer` writes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, nearest
from loopcal.files.machines.identifiable import Told, identifiable
from loopcal.files.machines.parameter_entries import changed
from loopcal.files.machines.python_function import Loops
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown
from loopcal.mechanisms.mechanism import Mechanism, Placement
from loopcal.mechanisms.parameters import Parameters


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
    placement: Placement | None = None,
) -> Mechanism:
    """The mechanism that a table describes, without its schema.

    place: the file (and key) it stands at, for messages; parameters: a project's [parameters],
    in which a mechanism of the type "function" may declare its own; told: what a project will say
    of the parameters, around which those of a chain are chosen that are fixed; placement: in place
    of the one that its instruments give it.

    Raises InputError as `read_mechanism` does.
    """
    from loopcal.files.machines.effects import affected
    from loopcal.files.machines.machine_type import ArmModel, ChainModel, MachineModel
    from loopcal.files.machines.registry import kinds, machine_type, table_of
    from loopcal.files.toml.model import validated

    place = Place(place) if isinstance(place, str) else place
    kind, named = str(data.get("type", "")), "type" in data
    try:
        table = table_of(kind)
    except KeyError:
        raise InputError(
            f"there is no type {kind!r}" if named else "the mechanism's type is missing",
            code="unknown-name",
            place=str(place.at("type") if named else place),
            remedy=nearest(kind, kinds()),
        ) from None
    model = validated(table, dict(data), place)
    if kind == "function":
        from loopcal.files.machines.declared_function import declared_function

        return declared_function(model, function, parameters or {}, place)
    if function is not None:
        raise InputError(
            f"this describes a mechanism of type {kind!r}, but a function is named as well",
            code="conflicting-keys",
            place=str(place),
            remedy='leave the function out, or describe the mechanism as type = "function"',
        )
    units = model.units.by_dimension()
    try:
        made = machine_type(kind).build(model, units, place)
    except InputError as error:
        raise error if error.place else error.at(str(place)) from None
    if placement is not None:
        made = replace(made, placement=placement)
    made = affected(made, model.effect, units, place.at("effect"))

    def stated(parameters: Parameters) -> Parameters:
        return changed(parameters, model.parameters, place.at("parameters"), units)

    if isinstance(model, ArmModel) and model.gravity is not None:
        made = _pulled(made, model.gravity, place)
    if isinstance(model, ChainModel):
        made = replace(made, remarks=tuple(model.remarks))
        if model.fix_redundant:
            made = identifiable(made, lambda p: stated(p) if told is None else told(stated(p)))
    if isinstance(model, MachineModel) and model.structure is not None:
        return _structured(made, model, units, place)
    return made.with_parameters(stated(made.parameters))


def _pulled(mechanism: Mechanism, gravity: Sequence[float], place: Place) -> Mechanism:
    try:
        return mechanism.with_gravity(gravity)
    except InputError as error:
        raise error.at(str(place.at("gravity"))) from None


def _structured(
    mechanism: Mechanism, model: Any, units: Mapping[str, str], place: Place
) -> Mechanism:
    """The mechanism with its model error, around all that the file says of its parameters.

    Priors by kind come after those of the file, and its values after the parameters that they are
    of.
    """
    from loopcal.files.machines.entries import built
    from loopcal.mechanisms.structure.structured import structured
    from loopcal.mechanisms.terms import stated_terms

    entries, here = model.parameters, place.at("parameters")
    plain = mechanism.parameters
    own = {key: e for key, e in entries.items() if any(fnmatchcase(n, key) for n in plain.names)}
    made: Mechanism = built(
        structured,
        model.structure,
        units,
        place.at("structure"),
        mechanism=mechanism.with_parameters(changed(plain, own, here, units)),
    )
    sure = {key: False for key, e in entries.items() if e.sd is not None or e.fixed}
    parameters = changed(made.parameters, entries, here, units)
    terms = stated_terms(made.terms, parameters, sure)
    return replace(made, parameters=parameters, terms=terms)
