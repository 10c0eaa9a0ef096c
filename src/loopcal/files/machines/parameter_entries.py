"""Parameters as files speak of them: by name or glob, each number with a unit that must fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.toml.place import Place
from loopcal.mechanisms.parameters import Parameter, Parameters
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.machines.mechanism_parts import ParameterEntry

NO_UNITS: Mapping[str, str] = {}


def in_si(
    number: float,
    stated: str | None,
    si: str,
    place: Place,
    units: Mapping[str, str] = NO_UNITS,
    *,
    difference: bool = False,
) -> float:
    """A number in its stated unit, in the file's unit of that dimension, or in SI, as SI value.

    si: the unit that is expected; units: dimension -> the file's unit; difference: the number is
    an sd, a step or a span, which has no zero. A number that is SI already comes back as it is,
    bit for bit. Raises InputError for a unit of another dimension.
    """
    expected = unit(si)
    given = unit(stated or units.get(expected.dimension, si))
    if given.dimension != expected.dimension:
        raise InputError(
            f"{given.name} is a unit of {given.dimension}, but this needs {expected.dimension} "
            f"({expected.si})",
            code="wrong-unit",
            place=str(place),
            remedy=f"give a unit of {expected.dimension}, or none for {expected.si}",
        )
    value = number if given.factor == 1.0 else number * given.factor
    return value if difference or not given.zero else value + given.zero


def changed(
    parameters: Parameters,
    entries: Mapping[str, ParameterEntry],
    place: Place,
    units: Mapping[str, str] = NO_UNITS,
) -> Parameters:
    """The parameters with the values, prior sds and fixed flags of the entries; later ones win.

    Raises InputError for a name or glob that stands for nothing, and a unit that does not fit.
    """
    changes: dict[str, dict[str, Any]] = {name: {} for name in parameters.names}
    for key, entry in entries.items():
        here = place.at(key)
        for name in _matching(parameters, key, here):
            si, at = parameters[name].unit, here.at("unit")
            if entry.value is not None:
                changes[name]["nominal"] = in_si(entry.value, entry.unit, si, at, units)
            if entry.sd is not None:
                changes[name]["prior_sd"] = in_si(
                    entry.sd, entry.unit, si, at, units, difference=True
                )
            if entry.fixed is not None:
                changes[name]["fixed"] = entry.fixed
            if changes[name].get("prior_sd") == 0.0 and changes[name].get("fixed") is False:
                raise InputError(
                    f"the sd of {name!r} is 0, which fixes it, but fixed = false frees it",
                    code="conflicting-keys",
                    place=str(here),
                    remedy="give a positive sd, or leave fixed = false out",
                )
    return Parameters(tuple(replace(p, **changes[p.name]) for p in parameters))


def _matching(parameters: Parameters, key: str, place: Place) -> tuple[str, ...]:
    try:
        return parameters.matching(key)
    except InputError as error:
        raise error.at(str(place)) from None


def declared_here(entries: Mapping[str, ParameterEntry], place: Place) -> dict[str, Parameter]:
    """Parameters that a file declares for a function: each plain name with value and unit.

    Raises InputError where a value or a unit is missing.
    """
    found = {}
    for name, entry in entries.items():
        if any(c in name for c in "*?["):
            continue
        for key, example in (("value", "0.8"), ("unit", '"m", "rad" or "1"')):
            if getattr(entry, key) is None:
                raise InputError(
                    f"the parameter {name!r} is declared without a {key}",
                    code="missing-key",
                    place=str(place.at(name)),
                    remedy=f"give {key} = {example}",
                )
        assert entry.value is not None
        assert entry.unit is not None
        si = unit(entry.unit).si
        found[name] = Parameter(name, in_si(entry.value, entry.unit, si, place), si)
    return found
