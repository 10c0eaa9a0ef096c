"""The covariance of a result's parameters, from what was written of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.document.fit import CovarianceEntry
from loopcal.document.triangle import symmetric
from loopcal.small_samples import LearntCovariance


def stored_covariance(
    entry: CovarianceEntry, determined: Sequence[Sequence[float]] | None
) -> LearntCovariance:
    """The covariance over the determined directions, and how sure it is itself.

    determined: the matrix over these directions where the entry's own has gaps.
    """
    n = len(entry.names)

    def square(rows: Sequence[Sequence[float | None]]) -> NDArray[np.float64]:
        # Null is what nothing limits: undetermined steps stand for it, and 0 here.
        return np.asarray(np.nan_to_num(np.array(rows, dtype=float)).reshape(n, n))

    matrix = square(entry.matrix if determined is None else determined)
    plain = matrix if entry.plain is None else symmetric(entry.plain)
    slopes = np.array([symmetric(s) for s in entry.slopes]).reshape(-1, n, n)
    return LearntCovariance(matrix, plain, slopes)
