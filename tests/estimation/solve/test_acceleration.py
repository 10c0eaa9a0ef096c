"""Accelerated steps: what slow steps show of the curvature that Gauss-Newton leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.solve.course import MOST, accelerated, remembered
from loopcal.estimation.solve.reduction import Spectrum, Stacked, Summed

Array = NDArray[np.float64]
N = 8


def descent(curvature: Array, *, triangular: bool, steps: int, fast: bool) -> list[float]:
    """Distances to the optimum of a quadratic whose curvature Gauss-Newton does not know."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(3 * N, N))
    H = A.T @ A
    scale = 1.0 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H)
    root = (vectors * np.sqrt(values)) @ vectors.T
    true = root @ np.diag(curvature) @ root  # true = curvature times what Gauss-Newton takes it for
    recent: Array | None = None
    p, off = rng.normal(size=N), []
    for _ in range(steps):
        g = -true @ p
        scaled = H * scale * scale[:, None]
        if triangular:
            R: Array = np.asarray(np.linalg.cholesky(scaled).T, dtype=np.float64)
            system = Spectrum(scale, Stacked(R, np.linalg.solve(R.T, scale * g)))
        else:
            system = Spectrum(scale, Summed(scaled, scale * g))
        found = accelerated(recent, system) if fast and recent is not None else None
        step = system.step() if found is None else found
        recent = remembered(recent, system.step(), step)
        p = p + step
        off.append(float(np.sqrt(p @ H @ p)))
    return off


@pytest.mark.parametrize("triangular", [False, True])
@pytest.mark.parametrize("slow", [(1.9, 1.0), (0.3, 1.8), (0.3, 0.5)])
def test_directions_that_converge_slowly_end_in_a_few_steps(
    slow: tuple[float, float], triangular: bool
) -> None:
    curvature = np.ones(N)
    curvature[:2] = slow
    plain = descent(curvature, triangular=triangular, steps=6, fast=False)
    fast = descent(curvature, triangular=triangular, steps=6, fast=True)
    assert fast[-1] < 1e-7 * fast[0]
    assert plain[-1] > 1e-2 * plain[0]


def test_a_step_that_would_lead_far_away_is_not_taken() -> None:
    system = Spectrum(np.ones(2), Summed(np.eye(2), np.array([1.0, 0.0])))
    step = np.array([1.0, 0.0])
    # the step before was the same but for a hair: the optimum seems a hundred steps away
    recent = remembered(None, 1.01 * step, 1.01 * step)
    assert accelerated(recent, system) is None


def test_only_the_last_steps_are_remembered() -> None:
    recent = None
    for i in range(MOST + 3):
        recent = remembered(recent, np.full(2, float(i)), np.full(2, -float(i)))
    assert recent is not None
    assert recent.shape == (MOST, 2, 2)
    assert recent[:, 0, 0].tolist() == [float(i) for i in range(3, MOST + 3)]
