"""A finished project file as text, with what was understood and why beside every line of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from loopcal.files.toml.reader import SCHEMA
from loopcal.files.toml.writer import line, one_line, tables

_LISTS = ("joint", "instrument")


@dataclass(frozen=True)
class ProjectParts:
    """A project as plain tables.

    mechanism: its table, joints and instruments included; parameters: name -> entry; data: a table
    for each file, the first the main one; noise: key -> entry; remarks: section -> comments.
    """

    title: str
    mechanism: Mapping[str, Any]
    parameters: Mapping[str, Any]
    data: Sequence[Mapping[str, Any]]
    noise: Mapping[str, Any]
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)


def project_text(parts: ProjectParts) -> str:
    """The text of a project file."""

    def remark_lines(section: str) -> list[str]:
        return [row for words in parts.remarks.get(section, ()) for row in _comment(words)]

    plain = {k: v for k, v in parts.mechanism.items() if k not in _LISTS}
    rows = [
        "# Written by loopcal init. Paths are relative to this file; change whatever is wrong.",
        line("schema", SCHEMA),
        line("title", parts.title),
        "",
        *remark_lines("mechanism"),
        "[mechanism]",
        *(line(k, v) for k, v in plain.items()),
    ]
    for key in _LISTS:
        rows += tables(f"mechanism.{key}", parts.mechanism.get(key, ()))
    if parts.parameters:
        rows += ["", *remark_lines("parameters"), "[mechanism.parameters]"]
        rows += [line(k, v) for k, v in parts.parameters.items()]
    rows += ["", *remark_lines("data")]
    for i, entry in enumerate(parts.data):
        name = "[data]" if i == 0 else "[[data.join]]"
        rows += ([""] if i else []) + [name]
        rows += [line(k, v) for k, v in entry.items() if k != "columns"]
        rows += [f"[{name.strip('[]')}.columns]"]
        rows += [line(k, v) for k, v in entry["columns"].items()]
    rows += ["", *remark_lines("noise"), "[noise]", *(line(k, v) for k, v in parts.noise.items())]
    return "\n".join(rows) + "\n"


def _comment(words: str, width: int = 98) -> list[str]:
    """Lines of a comment."""
    import textwrap

    return textwrap.wrap(one_line(words), width, initial_indent="# ", subsequent_indent="#   ")
