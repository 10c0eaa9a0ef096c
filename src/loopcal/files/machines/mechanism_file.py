"""Mechanism files (TOML): a machine's joints or loops, its nominal values, and how sure these are.

A file states `schema = 1` and a `type`; every number may carry a unit of its own, numbers without
one are in the file's `units`, and without these in SI (m, rad). `mechanism_writer` writes them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, placed, unknown_name
from loopcal.files.machines.parameter_entries import (
    StatedParameter,
    by_dimension,
    changed,
    entries_of,
)
from loopcal.files.machines.python_function import Loops
from loopcal.files.result.pair import refuse_stale
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.reader import checked_schema, read_toml, shown
from loopcal.mechanisms.masses import with_masses, with_payload
from loopcal.mechanisms.mechanism import Mechanism, Placement
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.redundancy import fix_redundant
from loopcal.mechanisms.station import Station

ParameterChange = Callable[[Parameters], Parameters]
"""Parameters with the values, prior sds and fixed flags that a mechanism file or project states."""


def read_mechanism(
    path: str | Path,
    *,
    function: Loops | Mechanism | None = None,
    instruments: Sequence[Mapping[str, Any]] | None = None,
    effects: Sequence[Mapping[str, Any]] | None = None,
    same: Mapping[str, Any] | None = None,
    told: ParameterChange | None = None,
) -> Mechanism:
    """The mechanism of a file.

    function: for a file of the type "function", which declares everything but the code: the
    loops f(x, p), or the mechanism made of them, whose values the file then replaces;
    instruments, effects, same: [[instrument]], [[effect]] and [same] tables in place of the file's
    own; told: as in `mechanism_from_data`.

    Raises InputError, naming file and key, for all that cannot be read or does not fit, and for the
    machine of another result than the one beside it.
    """
    refuse_stale(path)
    data = read_toml(path)
    place = Place(shown(path))
    checked_schema(data, place)
    stated = {key: value for key, value in data.items() if key != "schema"}
    if instruments is not None:
        stated["instrument"] = list(instruments)
    if effects is not None:
        stated["effect"] = list(effects)
    if same is not None:
        stated["same"] = dict(same)
    return mechanism_from_data(stated, place, function=function, change=told)


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
    change: ParameterChange | None = None,
    placement: Placement | None = None,
) -> Mechanism:
    """The mechanism that a table describes, without its schema.

    place: the file (and key) it stands at, for messages. parameters: a project's [parameters],
    in which a mechanism of the type "function" may declare its own. change: what a project will say
    of the parameters, around which those of a chain are chosen that are fixed. placement: in place
    of the one that its instruments give it.

    Raises InputError as `read_mechanism` does.
    """
    from loopcal.files.machines.machine_type import ArmTable, ChainTable, MachineTable
    from loopcal.files.machines.registry import kinds, machine_type, table_of
    from loopcal.files.toml.model import validated
    from loopcal.files.toml.tables import Tables, built

    place = Place(place) if isinstance(place, str) else place
    kind, named = str(data.get("type", "")), "type" in data
    try:
        model = table_of(kind)
    except KeyError:
        raise unknown_name(
            f"there is no type {kind!r}" if named else "the mechanism's type is missing",
            kind,
            kinds(),
            str(place.at("type") if named else place),
        ) from None
    entry = validated(model, dict(data), place)
    if kind == "function":
        from loopcal.files.machines.declared_function import Function, declared_function

        table = built(Function, entry, Scope(), place)
        return declared_function(table, function, parameters or {}, place)
    if function is not None:
        raise InputError(
            f"this describes a mechanism of type {kind!r}, but a function is named as well",
            code="conflicting-keys",
            place=str(place),
            remedy='leave the function out, or describe the mechanism as type = "function"',
        )
    row = machine_type(kind)
    units = by_dimension(Tables(row.common, entry, place).made("units"))
    scope = Scope(units)
    table = built(row.common, entry, scope, place)
    entries, of_station = dict(table.parameters), {}
    if isinstance(table, ArmTable) and table.station is not None:
        # These parameters do not exist before `_seen_from`, so what is stated of them waits.
        station_names = Station(table.station).parameters
        of_station = {n: entries.pop(n) for n in station_names if n in entries}
    with placed(place, unless_stated=True):
        made = row.build(table, entry, scope, place)
    if placement is not None:
        made = replace(made, placement=placement)
    if table.effect:
        from loopcal.files.machines.attached import affected

        made = affected(made, table.effect, scope, place.at("effect"))

    for key, change_by in _STATED.items():
        if (value := getattr(table, key, None)) not in (None, (), {}):
            with placed(place.at(key)):
                made = change_by(made, value)

    def stated(parameters: Parameters) -> Parameters:
        return changed(parameters, entries, place.at("parameters"), units)

    if isinstance(table, ChainTable):
        made = replace(made, remarks=table.remarks)
        if table.fix_redundant:
            made = identifiable(made, lambda p: stated(p) if change is None else change(stated(p)))
    if isinstance(table, MachineTable) and table.structure is not None:
        made = _structured(made, table.structure, entries, units, place)
    else:
        made = made.with_parameters(stated(made.parameters))
    if isinstance(table, ArmTable) and table.station is not None:
        made = _seen_from(made, table.station, place)
    parameters_place = place.at("parameters")
    return made.with_parameters(changed(made.parameters, of_station, parameters_place, units))


_STATED: Mapping[str, Callable[[Mechanism, Any], Mechanism]] = {
    "same": Mechanism.with_same,
    "gravity": Mechanism.with_gravity,
    "mass": with_masses,
    "payload": with_payload,
}
"""Key of a machine's table -> what it changes, in this order."""


def _seen_from(mechanism: Mechanism, station: str, place: Place) -> Mechanism:
    from loopcal.mechanisms.station import stationed

    placed = {f.placement.name for f in mechanism.families if isinstance(f.placement, Station)}
    if station in placed and isinstance(mechanism.placement, ChainPlacement):
        return mechanism  # an effect changes it along the run
    made = stationed(mechanism, station)
    if made is mechanism:
        raise InputError(
            f"{mechanism.name!r} does not hold its placement in transitions, so it cannot be "
            f"looked at from the station {station!r}",
            code="conflicting-keys",
            place=str(place.at("station")),
            remedy="name the station of its instrument",
        )
    return made


def _structured(
    mechanism: Mechanism,
    structure: Mapping[str, Any],
    entries: Mapping[str, StatedParameter],
    units: Mapping[str, str],
    place: Place,
) -> Mechanism:
    """The mechanism with its model error, around all that the file says of its parameters.

    Priors by kind come after those of the file, and its values after the parameters that they are
    of.
    """
    from loopcal.mechanisms.structure.structured import structured
    from loopcal.mechanisms.terms import stated_terms

    parameters_place, plain = place.at("parameters"), mechanism.parameters
    before = mechanism.with_parameters(
        changed(plain, entries_of(plain, entries), parameters_place, units)
    )
    with placed(place.at("structure")):
        made = structured(before, **structure)
    sure = {key: False for key, e in entries.items() if e.sd is not None or e.fixed}
    parameters = changed(made.parameters, entries, parameters_place, units)
    terms = stated_terms(made.terms, parameters, sure)
    return replace(made, parameters=parameters, terms=terms)


def identifiable(mechanism: Mechanism, change: ParameterChange) -> Mechanism:
    """The mechanism with those of a chain's parameters fixed that readings cannot tell from others.

    change: what the file states of them; parameters that it sets free stay free, and come
    first. Then come the instruments' parameters, which are not taken at their nominal values
    unless these are stated, then the chain's.
    """
    plain = mechanism.parameters
    # What a change states is independent of the values before: from two different ones it shows.
    other = Parameters(tuple(replace(p, nominal=p.nominal + 1.0, fixed=True) for p in plain))
    said, said_of_other = change(plain), change(other)
    both = zip(said, said_of_other, strict=True)
    return fix_redundant(
        mechanism.with_parameters(said),
        keep=said_of_other.free,  # fixed before, and set free
        stated=[p.name for p, q in both if p.nominal == q.nominal],
    )
