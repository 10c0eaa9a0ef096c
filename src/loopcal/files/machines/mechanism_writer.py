"""Mechanisms as TOML files, such that reading them back gives the same machine, bit for bit."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from loopcal.files.toml.reader import SCHEMA
from loopcal.files.toml.writer import inline, line, one_line, tables
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
    described = mechanism.description or {"type": "function"}
    if folder is not None and SOURCE in described:
        described = {**described, SOURCE: _seen_from(folder, described[SOURCE])}
    head = [
        f"# {one_line(mechanism.name)}: a mechanism file of loopcal, made by it.",
        "# Lengths are in m, angles in rad, sds in the unit of their value.",
        *_REMARKS.get(described["type"], ()),
        "",
        line("schema", SCHEMA),
        line("type", described["type"]),
        line("name", mechanism.name),
    ]
    parts = [
        *head,
        *([line("instrument", [])] if described.get("instrument") == [] else []),
        *_structure(mechanism, described),
        *tables("instrument", described.get("instrument", [])),
        *tables("effect", described.get("effect", [])),
        *_model_error(described),
        "",
        "# value: nominal; sd: how well it is known beforehand, absent where not at all;",
        "# fixed = true: not estimated.",
        "[parameters]",
        *(
            line(p.name, _parameter(p, described.get("held", ())) | _sd(mechanism, p))
            for p in mechanism.parameters
        ),
    ]
    return "\n".join(parts) + "\n"


def source_file(mechanism: Mechanism) -> Path | None:
    """The file that a mechanism was read from, where it is known and still there."""
    path = Path((mechanism.description or {}).get(SOURCE, ""))
    return path if path.is_file() else None


def _seen_from(folder: str | Path, path: str) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return path


_REMARKS = {
    "function": ("# The loops are a Python function: name it with --mechanism FILE.py:FUNCTION.",)
}


_APART = ("type", "joints", "instrument", "effect", "structure", "held")
"""What of a description is written at a place of its own."""


def _structure(mechanism: Mechanism, described: Mapping[str, Any]) -> list[str]:
    """What stands above the tables, and the joints."""
    stated = {key: value for key, value in described.items() if key not in _APART}
    if described["type"] == "function":
        stated = {
            "quantities": mechanism.quantities,
            "known": mechanism.pose_constants,
            "outputs": mechanism.outputs,
            "loops": mechanism.tape.loops,
        }
    return [
        *(line(key, value) for key, value in stated.items() if value not in ((), [], {})),
        *_remarks(mechanism),
        *tables("joint", [plain(joint) for joint in described.get("joints", [])]),
    ]


def _remarks(mechanism: Mechanism) -> list[str]:
    if not mechanism.remarks:
        return []
    return ["remarks = [", *(f"    {inline(words)}," for words in mechanism.remarks), "]"]


def _model_error(described: Mapping[str, Any]) -> list[str]:
    if "structure" not in described:
        return []
    return ["", "[structure]", *(line(k, v) for k, v in described["structure"].items())]


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
