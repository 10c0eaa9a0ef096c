"""The step of a search that keeps every variance above its bound."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from loopcal.estimation.noise import search


@pytest.mark.parametrize("draw", range(40))
def test_the_least_above_zero_is_that_of_scipy(draw: int) -> None:
    """Columns of unit length, alike or not, and sides of any size."""
    rng = np.random.default_rng(draw)
    n = int(rng.integers(1, 13))
    A = rng.normal(size=(n, n)) + (draw % 3) * rng.normal(size=(n, 1))
    A /= np.linalg.norm(A, axis=0)
    b = rng.normal(size=n) * 10.0 ** rng.uniform(-6, 6)
    u, least = search._least_above_zero(A, b), nnls(A, b)[1]
    assert (u >= 0.0).all()
    assert np.linalg.norm(A @ u - b) <= least + 1e-10 * np.linalg.norm(b)


def test_columns_that_are_the_same_end_the_search() -> None:
    """Rounding may offer one and the same again and again."""
    A = np.ones((3, 3)) / np.sqrt(3.0)
    u = search._least_above_zero(A, np.array([1.0, 1.0, 1.0]))
    assert np.allclose(A @ u, 1.0)
    assert not search._least_above_zero(A, -np.ones(3)).any()
