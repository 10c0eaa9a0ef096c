"""Mechanisms as TOML files, such that reading them back gives the same machine, bit for bit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from loopcal.files.machines.parallel_entries import MAKERS as PARALLEL
from loopcal.files.toml.reader import SCHEMA
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint


def mechanism_to_toml(mechanism: Mechanism) -> str:
    """The text of a mechanism file: SI, every digit, prior sds and fixed parameters included.

    Loops written as a Python function are declared without their code (type "function"): whoever
    reads the file names the function again.
    """
    described = mechanism.description or {"type": "function"}
    head = [
        f"# {_comment(mechanism.name)}: a mechanism file of loopcal, made by it.",
        "# Lengths are in m, angles in rad, sds in the unit of their value.",
        *_REMARKS.get(described["type"], ()),
        "",
        _line("schema", SCHEMA),
        _line("type", described["type"]),
        _line("name", mechanism.name),
    ]
    parts = [
        *head,
        *([_line("instrument", [])] if described.get("instrument") == [] else []),
        *_structure(mechanism, described),
        *_tables("instrument", described.get("instrument", [])),
        *_tables("effect", described.get("effect", [])),
        "",
        "# value: nominal; sd: how well it is known beforehand, absent where not at all;",
        "# fixed = true: not estimated.",
        "[parameters]",
        *(_parameter(p, described.get("held", ())) for p in mechanism.parameters),
    ]
    return "\n".join(parts) + "\n"


_REMARKS = {
    "function": ("# The loops are a Python function: name it with --mechanism FILE.py:FUNCTION.",)
}


def _structure(mechanism: Mechanism, described: Mapping[str, Any]) -> list[str]:
    match described["type"]:
        case "serial":
            lines = [_line(key, described[key]) for key in ("base", "point") if key in described]
            lines += _remarks(mechanism)
            for joint in described["joints"]:
                lines += ["", *_joint(joint)]
            return lines
        case "urdf" | "exponentials":
            return [*_chain(described), *_remarks(mechanism), *_chain_joints(described)]
        case kind if kind in PARALLEL:
            given = {key: described.get(key) for key in ("passive", "home")}
            return [_line(key, value) for key, value in given.items() if value]
        case "motoman-ma1400":
            return [_line("before", described["before"])] if described["before"] else []
        case "function":
            return [
                _line("quantities", mechanism.quantities),
                *([_line("known", mechanism.known)] if mechanism.known else []),
                _line("outputs", mechanism.outputs),
                _line("loops", mechanism.tape.loops),
            ]
        case _:
            return []


def _tables(key: str, listed: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        line
        for entry in listed
        for line in ("", f"[[{key}]]", *(_line(k, value) for k, value in entry.items()))
    ]


def _joint(joint: Joint) -> list[str]:
    lines = ["[[joint]]", _line("name", joint.name), _line("form", joint.form)]
    lines += [_line("kind", joint.kind), _line("direction", joint.direction)]
    for key in ("before", "after"):
        motions: Mapping[str, float] = getattr(joint, key)
        lines += [_line(key, motions)] if motions else []
    return lines


def _chain(described: Mapping[str, Any]) -> list[str]:
    """What stands above the joints; the parameters say which of them are fixed."""
    lines = [_line("fix_redundant", False)]
    if described["type"] == "urdf":
        return [*lines, _line("axes", described["axes"])]
    xyz, rpy = described["home"]
    return [*lines, _line("home", {"xyz": xyz, "rpy": rpy})]


def _remarks(mechanism: Mechanism) -> list[str]:
    if not mechanism.remarks:
        return []
    return ["remarks = [", *(f"    {_line('x', words)[4:]}," for words in mechanism.remarks), "]"]


def _chain_joints(described: Mapping[str, Any]) -> list[str]:
    """Joints with all that is said of them."""
    lines = []
    for joint in described["joints"]:
        entry = {k: v for k, v in asdict(joint).items() if v is not None}
        lines += ["", "[[joint]]", *(_line(key, value) for key, value in entry.items())]
    return lines


def _parameter(parameter: Parameter, held: Sequence[str]) -> str:
    """held: parameters that are fixed unless the file says otherwise."""
    entry: dict[str, Any] = {"value": parameter.nominal, "unit": parameter.unit}
    if not math.isinf(parameter.prior_sd):
        entry["sd"] = parameter.prior_sd
    if parameter.fixed or parameter.name in held:
        entry["fixed"] = parameter.fixed
    return _line(parameter.name, entry)


def _line(key: str, value: Any) -> str:
    """`key = value` with tables and lists within the line."""
    import tomli_w

    if isinstance(value, Mapping):
        inner = ", ".join(_line(k, _number(v)) for k, v in value.items())
        return f"{_key(key)} = {{ {inner} }}" if inner else f"{_key(key)} = {{}}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"{_key(key)} = [{', '.join(_line('x', v)[4:] for v in value)}]"
    return tomli_w.dumps({key: _number(value)}).rstrip("\n")


def _key(key: str) -> str:
    return _line(key, 0)[: -len(" = 0")]


def _number(value: Any) -> Any:
    """Numbers of NumPy as Python's, whose repr survives reading exactly."""
    return float(value) if isinstance(value, float) else value


def _comment(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
