"""Matrices that NumPy's divide and conquer does not take apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loopcal.arrays import span, svd


def test_a_matrix_that_divide_and_conquer_gives_up_is_taken_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of 99 equations of a second day, 79 columns wide, of rank 56."""
    rng = np.random.default_rng(1)
    A = rng.standard_normal((99, 56)) @ rng.standard_normal((56, 79))
    expected = np.linalg.svd(A, compute_uv=False)

    def gives_up(*_: Any, **__: Any) -> Any:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", gives_up)
    U, s, Vt = svd(A)
    assert np.allclose(s, expected, rtol=0.0, atol=1e-12 * expected[0])
    assert np.allclose((U * s) @ Vt, A, atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        svd(np.full((3, 3), np.nan))


def test_a_span_counts_directions_not_units_and_leaves_out_what_is_zero() -> None:
    rng = np.random.default_rng(2)
    A = rng.standard_normal((30, 4))
    columns = np.column_stack([1e-9 * A[:, 0], A[:, 1:], np.zeros(30), 1e6 * A @ np.ones(4)])
    U = span(columns, 1e-10)
    assert U.shape == (30, 4)
    assert np.allclose(U @ (U.T @ A), A)
    assert span(np.zeros((5, 2)), 1e-10).shape == (5, 0)
