"""Symmetric matrices in files: the rows of their lower triangle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.arrays import Array

Rows = tuple[tuple[float, ...], ...]


def lower(matrix: Array) -> Rows:
    """Row i of a symmetric matrix (n, n) as its first i + 1 entries."""
    return tuple(tuple(row[: i + 1]) for i, row in enumerate(matrix.tolist()))


def symmetric(rows: Sequence[Sequence[float]]) -> Array:
    """The matrix (n, n) of such rows; whole rows, as older files have them, serve as well."""
    matrix = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        matrix[i, : i + 1] = matrix[: i + 1, i] = row[: i + 1]
    return matrix
