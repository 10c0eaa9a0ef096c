"""Typed values as plain data for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Dataclasses and mappings as dicts, sequences and arrays as lists, null for NaN, infinity."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        if set(map(type, value)) == {float} and all(map(math.isfinite, value)):
            return list(value)  # rows of matrices, most of a document
        return [plain(inner) for inner in value]
    return value


def finite_only(value: Any) -> Any:
    """Plain data without what JSON cannot say: infinity and NaN become text as TOML spells them."""
    if isinstance(value, Mapping):
        return {str(key): finite_only(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite_only(inner) for inner in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def finite(value: float | None) -> float | None:
    """None for a number that is not finite: it stands for what is unknown or unbounded."""
    return value if value is not None and math.isfinite(value) else None
