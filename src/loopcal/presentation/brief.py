"""Values whose numbers are too many to print, in one line."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from loopcal.errors import short


def brief(value: Any) -> str:
    """`<Kind: the names of its fields>`, as `__repr__` of a dataclass."""
    names = ", ".join(field.name for field in fields(value))
    return f"<{type(value).__name__}: {short(names, 200)}>"
