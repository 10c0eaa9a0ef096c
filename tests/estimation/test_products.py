"""Products of rows by pose with one matrix."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.products import rows_times, rows_times_upper


@pytest.mark.parametrize("shape", [(7, 3, 5), (0, 3, 5), (4, 0, 5), (2, 5)])
def test_rows_are_multiplied_as_one_by_one(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    rows, matrix = rng.normal(size=(*shape[:-1], shape[-1] + 1)), rng.normal(size=(5, 4))
    some = rows[..., :-1]  # not in one piece
    np.testing.assert_allclose(rows_times(some, matrix), some @ matrix, atol=1e-14)


@pytest.mark.parametrize("shape", [(7, 3, 5), (7, 3, 120), (0, 3, 120)])
def test_an_upper_triangle_multiplies_as_the_whole_matrix(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(*shape[:-1], shape[-1] + 1))[..., :-1]  # not in one piece
    matrix = np.triu(rng.normal(size=(shape[-1], shape[-1])))
    np.testing.assert_allclose(rows_times_upper(rows, matrix), rows @ matrix, atol=1e-12)
