"""What arrays of numbers are called in signatures, and how a matrix is taken apart.

Shapes stand in docstrings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def svd(A: Array) -> tuple[Array, Array, Array]:
    """U (m, k), s (k,), V^T (k, n) of A = U diag(s) V^T, (m, n), k the smaller of m and n.

    Divide and conquer, which NumPy uses, does not end for some finite matrices whose
    smallest singular values are rounding. Iteration by QR then does (Golub and Reinsch 1970).

    Raises LinAlgError for a matrix that holds infinity or NaN.
    """
    try:
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
    except np.linalg.LinAlgError:
        if not np.isfinite(A).all():
            raise
        from scipy.linalg import svd as by_iteration

        U, s, Vt = by_iteration(A, full_matrices=False, lapack_driver="gesvd")
    return U, s, Vt


def span(A: Array, least: float) -> Array:
    """(m, k) orthonormal columns that span those of A, (m, n).

    least: singular values of so small a share of the largest are zero, columns scaled to length 1.
    """
    length = np.linalg.norm(A, axis=0)
    U, s, _ = svd(A[:, length > 0.0] / length[length > 0.0])
    return U[:, s > least * s.max(initial=0.0)]
