"""The truth of a simulation, kept beside its readings: NAME.truth.json for NAME.csv."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from loopcal.errors import InputError, unknown_name
from loopcal.files.json_files import marked_json, read_json
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism

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
    from loopcal.files.toml.model import Value, validated

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
        place = Place(str(path)).at("parameters", name)
        whole = entry if isinstance(entry, dict) else {"value": entry}
        value = validated(Value, whole, place)
        truth[name] = in_si(value.value, value.unit, mechanism.parameters[name].unit, place)
    return MappingProxyType(truth)
