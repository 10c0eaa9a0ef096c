"""Typed values as plain data for JSON, and the kinds of numbers in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from annotated_types import Ge, Le

from loopcal.arrays import Array


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


Kind = TypeVar("Kind")


def rebuilt(kind: type[Kind], data: Any) -> Kind:
    """A dataclass from its plain data, keys beside its fields left out. Raises ValueError for data
    that do not fit."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_python(data)


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


# All numbers of result.json are finite: unknown is null.

Count = Annotated[int, Ge(0)]
Size = Annotated[float, Ge(0)]
Probability = Annotated[float, Ge(0), Le(1)]
Rows = tuple[tuple[float, ...], ...]
"""Symmetric matrices in files: the rows of their lower triangle."""


def lower(matrix: Array) -> Rows:
    """Row i of a symmetric matrix (n, n) as its first i + 1 entries."""
    return tuple(tuple(row[: i + 1]) for i, row in enumerate(matrix.tolist()))


def symmetric(rows: Sequence[Sequence[float]]) -> Array:
    """The matrix (n, n) of such rows; whole rows, as older files have them, serve as well."""
    matrix = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        matrix[i, : i + 1] = matrix[: i + 1, i] = row[: i + 1]
    return matrix
