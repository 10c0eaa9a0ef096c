"""The matrices of a result.json have the rows and columns that their names say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.files.toml.place import Place


@dataclass(frozen=True)
class _Matrix:
    """Where a matrix stands, its rows, and the lengths that each of them may have."""

    path: tuple[str | int, ...]
    rows: Sequence[Sequence[Any]]
    lengths: Sequence[tuple[int, ...]]

    @property
    def fits(self) -> bool:
        """Whether it has so many rows of these lengths."""
        return len(self.rows) == len(self.lengths) and all(
            len(row) in lengths for row, lengths in zip(self.rows, self.lengths, strict=True)
        )


def refuse_other_shapes(document: ResultDocument, place: Place, remedy: str) -> None:
    """Raise InputError for the first matrix whose rows do not fit its names."""
    for matrix in _matrices(document):
        if not matrix.fits:
            raise InputError(
                f"a matrix of {len(matrix.rows)} rows does not fit its names",
                code="wrong-shape",
                place=str(place.at(*matrix.path)),
                remedy=remedy,
            )


def _matrices(document: ResultDocument) -> Iterator[_Matrix]:
    covariance, ahead = document.covariance, document.prediction
    n = len(covariance.names)
    lower = [(i + 1, n) for i in range(n)]  # earlier versions wrote whole rows
    yield _Matrix(("covariance", "matrix"), covariance.matrix, [(n,)] * n)
    for name, rows in (("plain", covariance.plain), ("scatter", covariance.scatter)):
        if rows is not None:
            yield _Matrix(("covariance", name), rows, lower)
    for i, rows in enumerate(covariance.slopes):
        yield _Matrix(("covariance", "slopes", i), rows, lower)
    if ahead is not None:
        if ahead.covariance is not None:
            yield _Matrix(("prediction", "covariance"), ahead.covariance, [(n,)] * n)
        steps = ahead.undetermined
        yield _Matrix(("prediction", "undetermined"), steps, [(n,)] * len(steps))
    for i, entry in enumerate(document.noise_covariances):
        m = len(entry.quantities)
        yield _Matrix(("noise_covariances", i, "matrix"), entry.matrix, [(m,)] * m)
