"""Lines of TOML files, every number with all its digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def line(key: str, value: Any) -> str:
    """`key = value` with tables and lists within the line."""
    import tomli_w

    written_key = tomli_w.dumps({key: 0}).removesuffix(" = 0\n")
    return f"{written_key} = {inline(value)}"


def inline(value: Any) -> str:
    """A value as it stands behind its key."""
    import tomli_w

    if isinstance(value, Mapping):
        inner = ", ".join(line(k, v) for k, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(inline, value))}]"
    # numbers of NumPy as Python's, whose repr survives reading exactly
    plain_value = float(value) if isinstance(value, float) else value
    return tomli_w.dumps({"x": plain_value}).removeprefix("x = ").removesuffix("\n")


def tables(key: str, listed: Sequence[Mapping[str, Any]]) -> list[str]:
    """An array of tables, a blank line ahead of each."""
    return [
        text
        for entry in listed
        for text in ("", f"[[{key}]]", *(line(k, value) for k, value in entry.items()))
    ]


def one_line(text: str) -> str:
    """A text for a comment: what would end or steer the line is left out."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
