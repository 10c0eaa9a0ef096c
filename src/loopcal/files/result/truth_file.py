"""The truth of a simulation, kept beside its readings: NAME.truth.json for NAME.csv."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, placed, unknown_name
from loopcal.files.json_files import marked_json, read_json
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import convertible, to_si

if TYPE_CHECKING:
    from loopcal.simulation.simulate import Simulation

SCHEMA = 1


def truth_json(
    simulation: Simulation, mechanism: Mechanism, readings: Mapping[str, str | bytes]
) -> str:
    """Every true parameter, and the true values of every quantity in every pose [SI].

    readings: name -> content of the file beside it, whose SHA-256 it states.
    """
    document = {
        "schema": SCHEMA,
        "mechanism": mechanism.name,
        "seed": simulation.seed,
        "parameters": {
            p.name: {"value": simulation.parameters[p.name], "unit": p.unit}
            for p in mechanism.parameters
        },
        "poses": list(simulation.dataset.poses),
        "quantities": {
            name: {"unit": unit, "values": simulation.quantities[name].tolist()}
            for name, unit in mechanism.quantities.items()
        },
    }
    return marked_json(document, readings, indent=None)


def read_truth(path: str | Path, mechanism: Mechanism) -> Mapping[str, float]:
    """True parameters by name [SI], of those that the file states.

    Raises InputError for a file that is no truth, for a parameter the mechanism does not have,
    and for a value or unit that does not fit.
    """
    document = read_json(path, "truth.json", SCHEMA)
    stated = document.get("parameters")
    if not isinstance(stated, dict) or not stated:
        raise InputError(
            "the file states no true parameters",
            code="no-data",
            place=f"{path}: parameters",
            remedy="name the .truth.json that `loopcal simulate` wrote beside its readings",
        )
    truth = {}
    for name, entry in stated.items():
        if name not in mechanism.parameters.names:
            raise unknown_name(
                f"the mechanism {mechanism.name!r} has no parameter {name!r}",
                name,
                mechanism.parameters.names,
                f"{path}: parameters",
            )
        place = f"{path}: parameters.{name}"
        truth[name] = _value(entry, mechanism.parameters[name].unit, place)
    return MappingProxyType(truth)


def _value(entry: Any, expected: str, place: str) -> float:
    value = entry.get("value") if isinstance(entry, dict) else entry
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(
            f"the true value is {value!r}",
            code="invalid-number",
            place=place,
            remedy='give {"value": number, "unit": "..."}',
        )
    unit = entry.get("unit", expected) if isinstance(entry, dict) else expected
    with placed(place):
        fits = convertible(str(unit), expected)
    if not fits:
        raise InputError(
            f"the true value is in {unit}, the parameter in {expected}",
            code="wrong-unit",
            place=place,
            remedy=f"give a unit that converts to {expected}",
        )
    return to_si(float(value), str(unit))
