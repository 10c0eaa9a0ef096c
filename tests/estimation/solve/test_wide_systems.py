"""Wide parameter systems: damped steps by normal equations, and rows that wait for one QR."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.solve.reduction import LARGE, Accumulator, Spectrum, spectrum

N = LARGE + 20


def equations() -> NDArray[np.float64]:
    """Rows of D and E, (400, N + 1), whose columns are of many lengths and two all but alike."""
    draw = np.random.default_rng(0)
    rows = draw.normal(size=(400, N + 1)) * np.append(np.logspace(0.0, -4.0, N), 1.0)
    rows[:, 3] = rows[:, 4] + 1e-4 * rows[:, 3]
    return rows


def gathered(rows: NDArray[np.float64], block: int) -> Accumulator:
    """The rows in blocks of so many poses of one equation each."""
    data = Accumulator(N, True)
    for i in range(0, len(rows), block):
        data.add(rows[i : i + block].T[:, None, :])
    return data


def by_singular_values(
    system: Spectrum, damping: float, after: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Step and predicted fall as textbooks have them."""
    s, c = system.singular_values, system.components
    led = system.directions.T @ (after / system.scale)
    step = system.scale * (system.directions @ ((s * c - damping * led) / (s * s + damping)))
    left = np.square(damping / (s * s + damping))
    return step, float((1.0 - left) @ np.square(c))


@pytest.mark.parametrize("damping", [1e-9, 1e-6, 1e-2])
def test_a_damped_step_is_that_of_singular_values(damping: float) -> None:
    system = spectrum(gathered(equations(), 50), np.zeros(N), np.full(N, np.inf))
    after = np.random.default_rng(1).normal(size=N)
    step, _ = by_singular_values(system, damping, after)
    scaled = (system.step(damping, after=after) - step) / system.scale
    assert np.linalg.norm(scaled) < 1e-6 * np.linalg.norm(step / system.scale)
    assert system.predicted(damping) == pytest.approx(
        by_singular_values(system, damping, np.zeros(N))[1], rel=1e-9
    )
    least = float(np.square(system.singular_values.min()))
    assert system.weakest == pytest.approx(least, rel=0.1)


@pytest.mark.parametrize("block", [1, 7, 400])
def test_rows_that_wait_add_up_to_the_same_triangle(block: int) -> None:
    rows = equations()
    data = gathered(np.tile(rows, (2, 1)), block)
    products = 2.0 * rows.T @ rows
    assert data.chi_squared == pytest.approx(products[-1, -1], rel=1e-12)
    np.testing.assert_allclose(data.lengths, np.sqrt(np.diag(products)[:-1]), rtol=1e-12)
    np.testing.assert_allclose(data.products, products, rtol=1e-9, atol=1e-12)
    assert data.total.shape == (N + 1, N + 1)
    assert data.finite


def test_a_missing_number_is_seen_before_anything_is_reduced() -> None:
    rows = equations()
    rows[5, 7] = np.nan
    assert not gathered(rows, 50).finite
