"""Products of rows by pose with one matrix, in one call.

NumPy does a product of an array (b, r, n) with a matrix pose by pose, at a quarter of the speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rows_times(rows: Array, matrix: Array) -> Array:
    """Rows (..., n) times a matrix (n, k), (..., k)."""
    flat = rows.reshape(int(np.prod(rows.shape[:-1])), rows.shape[-1])
    found: Array = (flat @ matrix).reshape(*rows.shape[:-1], matrix.shape[1])
    return found
