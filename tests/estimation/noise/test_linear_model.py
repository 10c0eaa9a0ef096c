"""The linearised calibration, solved by a triangle as by its directions."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.noise.linear_model import KEPT, _by_directions, _by_triangle


@pytest.mark.parametrize("condition", [1e2, 1e5])
def test_a_determined_triangle_is_solved_as_by_its_directions(condition: float) -> None:
    rng = np.random.default_rng(1)
    columns, n = rng.normal(size=(40, 7)), 6
    U, _, Vt = np.linalg.svd(columns[:, :n], full_matrices=False)
    columns[:, :n] = (U * np.geomspace(1.0, 1.0 / condition, n)) @ Vt
    sizes = np.array([1e3, 1.0, 1e-2, 10.0, 1.0, 1.0, 1.0])
    R = np.asarray(np.linalg.qr(columns * sizes, mode="r"))
    scale = 1.0 / np.linalg.norm(R, axis=0)
    one, other = _by_triangle(R * scale, scale, 1.0 / KEPT), _by_directions(R)
    assert one is not None
    digits = 1e-14 * condition
    step, expected = one.root @ one.along, other.root @ other.along
    covariance = other.root @ other.root.T
    sds = np.sqrt(np.diag(covariance))
    assert np.abs(step - expected).max() <= digits * np.abs(expected).max()
    apart = (one.root @ one.root.T - covariance) / np.outer(sds, sds)
    assert np.abs(apart).max() <= digits
    assert one.residual == pytest.approx(other.residual, rel=digits)
    assert one.log_volume == pytest.approx(other.log_volume, abs=digits)


def test_a_triangle_with_an_open_direction_is_left_to_its_directions() -> None:
    columns = np.random.default_rng(2).normal(size=(40, 5))
    columns[:, 1] = columns[:, 0]
    R = np.asarray(np.linalg.qr(columns, mode="r"))
    assert _by_triangle(R, np.ones(5), 1.0 / KEPT) is None
    assert _by_directions(R).root.shape == (4, 3)
