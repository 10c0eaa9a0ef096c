"""A joint that stands still in every pose has no errors of its own in each."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.problem.problem import build_problem
from tests.reference.simulated import MA1400_RANGES, ma1400

NOISE = lc.Noise({f"theta_{i}": 5e-5 for i in range(1, 7)} | dict.fromkeys("xyz", 2e-5))
ARM = ma1400(2).truth
POSES = 60


def readings(seed: int, parked: float | None) -> lc.Dataset:
    """The arm's readings; the fourth joint, where parked, is read as the same number throughout."""
    low, high = MA1400_RANGES.T
    q = np.random.default_rng(seed).uniform(low, high, (POSES, 6))
    if parked is not None:
        q[:, 3] = parked
    poses = {f"theta_{i}": q[:, i - 1] for i in range(1, 7)}
    data = lc.simulate(ARM, poses, noise=NOISE, seed=seed).dataset
    return data if parked is None else data.with_readings({"theta_4": np.full(POSES, parked)})


def test_a_parked_joint_with_flat_priors_converges_and_chi_squared_is_that_of_the_noise() -> None:
    found = [
        lc.calibrate(ARM, readings(seed, 0.2), noise=NOISE, method="implicit-loop")
        for seed in range(1, 6)
    ]
    assert all(one.status.converged for one in found)
    assert all(0 < len(one.identifiability.loose) < 27 for one in found)
    chi_squared = sum(one.chi_squared.value for one in found if one.chi_squared)
    freedom = sum(one.chi_squared.degrees_of_freedom for one in found if one.chi_squared)
    assert chi_squared / freedom == pytest.approx(1.0, abs=4.0 * (2.0 / freedom) ** 0.5)


def test_a_joint_that_moves_keeps_its_sd_and_a_parked_one_has_none() -> None:
    moved, parked = (build_problem(ARM, readings(1, at), NOISE) for at in (None, 0.2))
    fourth = ARM.tape.quantities.index("theta_4")
    assert (moved.uncertainty.sd > 0.0).all()
    assert np.flatnonzero(parked.uncertainty.sd[:, 0] == 0.0).tolist() == [fourth]


def test_equal_readings_of_an_instrument_are_readings() -> None:
    data = readings(1, None)
    level = data.with_readings({"z": np.full(POSES, 0.5)})
    assert (build_problem(ARM, level, NOISE).uncertainty.sd > 0.0).all()
