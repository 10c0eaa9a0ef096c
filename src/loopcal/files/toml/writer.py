"""TOML files as text, every number with all its digits: one writer for all that loopcal writes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

WIDTH = 98
"""Characters of a line of comments."""
_OF_A_MECHANISM = ("joint", "instrument", "effect", "structure", "parameters")
SECTIONS = frozenset(
    (
        *("mechanism", *_OF_A_MECHANISM, "prior", "data", "join", "source", "columns", "noise"),
        *("plan", "ranges"),
    )
)
"""Tables, and lists of tables, with lines of their own; others stand within a line."""
NO_REMARKS: Mapping[str, Sequence[str]] = {}


def document(
    tables: Mapping[str, Any],
    head: Sequence[str] = (),
    remarks: Mapping[str, Sequence[str]] = NO_REMARKS,
) -> str:
    """The text of a file: plain values, then each table and each entry of a list of tables.

    head: comments of the file, "" for a blank line; remarks: name of a table, as it stands between
    its brackets -> comments above it.
    """
    above = [row for words in head for row in _comment(words)]
    return "\n".join([*above, *_lines(tables, "", remarks)]) + "\n"


def _lines(
    table: Mapping[str, Any], path: str, remarks: Mapping[str, Sequence[str]]
) -> Iterator[str]:
    apart = [
        k
        for k, v in table.items()
        if k in SECTIONS and (_are_tables(v) or (isinstance(v, Mapping) and v))
    ]
    yield from (_line(key, value) for key, value in table.items() if key not in apart)
    for key in apart:
        name, value = f"{path}{key}", table[key]
        above = [row for words in remarks.get(name, ()) for row in _comment(words)]
        listed = _are_tables(value)
        for entry in value if listed else [value]:
            yield from [""] if listed or above or not path else []
            yield from (*above, f"[[{name}]]" if listed else f"[{name}]")
            yield from _lines(entry, f"{name}.", remarks)
            above = []


def _are_tables(value: Any) -> bool:
    return isinstance(value, Sequence) and bool(value) and isinstance(value[0], Mapping)


def _line(key: str, value: Any) -> str:
    """`key = value`; a text in a list has a line where they do not fit into one."""
    inner = _inline(value)
    texts = isinstance(value, Sequence) and all(isinstance(one, str) for one in value)
    if texts and not isinstance(value, str) and len(inner) > WIDTH:
        inner = "\n".join(["[", *(f"    {_inline(one)}," for one in value), "]"])
    return f"{_key(key)} = {inner}"


def _key(key: str) -> str:
    import tomli_w

    return tomli_w.dumps({key: 0}).removesuffix(" = 0\n")


def _inline(value: Any) -> str:
    """A value as it stands behind its key."""
    import tomli_w

    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_inline, value))}]"
    # numbers of NumPy as Python's, whose repr survives reading exactly
    plain_value = float(value) if isinstance(value, float) else value
    return tomli_w.dumps({"x": plain_value}).removeprefix("x = ").removesuffix("\n")


def _comment(words: str) -> list[str]:
    """Lines of a comment: what would end or steer them is left out."""
    text = "".join(c if c.isprintable() else " " for c in " ".join(words.split()))
    rows = textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="#   ")
    return rows or [""]
