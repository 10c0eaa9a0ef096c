"""Mechanisms as TOML files, such that reading them back gives the same machine, bit for bit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from loopcal.files.outputs import relative
from loopcal.files.toml.reader import SCHEMA
from loopcal.files.toml.writer import document
from loopcal.keys import plain
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.structure.structured import STRUCTURE_TERMS

SOURCE = "source"
"""Key of a description: path of the file that the machine was read from."""


def mechanism_to_toml(mechanism: Mechanism, folder: str | Path | None = None) -> str:
    """The text of a mechanism file: SI, every digit, prior sds and fixed parameters included.

    folder: in which it will stand; the path of a source is written as seen from it.

    Loops written as a Python function are declared without their code (type "function"): whoever
    reads the file names the function again.
    """
    table = mechanism_table(mechanism)
    if folder is not None and SOURCE in table:
        table[SOURCE] = relative(table[SOURCE], folder)
    head = [
        f"{mechanism.name}: a mechanism file of loopcal, made by it.",
        "Lengths are in m, angles in rad, sds in the unit of their value.",
        *([_FUNCTION] if table["type"] == "function" else []),
        "",
    ]
    return document({"schema": SCHEMA, **table}, head, {"parameters": _PARAMETERS})


def mechanism_table(mechanism: Mechanism) -> dict[str, Any]:
    """The table that describes a mechanism, as `mechanism_from_data` takes it."""
    described = dict(mechanism.description or {"type": "function"})
    if described["type"] == "function":
        described |= _declared(mechanism)
    held, described["joint"] = described.pop("held", ()), described.pop("joints", ())
    described["body"] = described.pop("bodies", ())
    # A machine without instruments calibrates itself: its list is empty, not absent.
    none: dict[str, Any] = {"instrument": []} if described.get("instrument") == [] else {}
    table = {
        "type": described["type"],
        "name": mechanism.name,
        **{key: value for key, value in described.items() if key not in _BELOW},
        "remarks": mechanism.remarks,
        **{key: described.get(key, ()) for key in _BELOW},
        "parameters": {
            p.name: _parameter(p, held) | _sd(mechanism, p) for p in mechanism.parameters
        },
    }
    stated = {key: plain(value) for key, value in table.items() if value not in ((), [], {})}
    return {"type": stated.pop("type"), "name": stated.pop("name"), **none, **stated}


def _declared(mechanism: Mechanism) -> dict[str, Any]:
    """What a file says of loops written in Python."""
    return {
        "quantities": mechanism.quantities,
        "known": mechanism.pose_constants,
        "outputs": mechanism.outputs,
        "loops": mechanism.tape.loops,
        "home": mechanism.home,
    }


def source_file(mechanism: Mechanism) -> Path | None:
    """The file that a mechanism was read from, where it is known and still there."""
    path = Path((mechanism.description or {}).get(SOURCE, ""))
    return path if path.is_file() else None


_BELOW = ("joint", "body", "mass", "instrument", "effect", "structure", "same")
"""What stands below the plain values, in this order."""
_FUNCTION = "The loops are a Python function: name it with --mechanism FILE.py:FUNCTION."
_PARAMETERS = (
    "value: nominal; sd: how well it is known beforehand, absent where not at all;",
    "fixed = true: not estimated.",
)


def _parameter(parameter: Parameter, held: Sequence[str]) -> dict[str, Any]:
    """held: parameters that are fixed unless the file says otherwise."""
    entry: dict[str, Any] = {"value": parameter.nominal, "unit": parameter.unit}
    if parameter.fixed or parameter.name in held:
        entry["fixed"] = parameter.fixed
    return entry


def _sd(mechanism: Mechanism, parameter: Parameter) -> dict[str, float]:
    """The prior sd, where it is not that which the reader gives the parameter."""
    structure = "structure" in (mechanism.description or {})
    if structure and any(
        parameter.name in term.parameters
        for term in mechanism.terms
        if term.name in STRUCTURE_TERMS
    ):
        return {}
    mounted = structure and parameter.role == "mounting"
    return {"sd": parameter.prior_sd} if mounted or math.isfinite(parameter.prior_sd) else {}
