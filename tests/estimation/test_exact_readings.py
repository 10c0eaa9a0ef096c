"""Exact readings give back the true parameters, whatever the sds say."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.measurements.noise import Noise
from tests.reference.machines import MACHINES
from tests.reference.simulated import Simulated, arm_at, ma1400, planar_arm

ARMS = {"planar": planar_arm(), "MA1400": ma1400()}


def worst_error(simulated: Simulated, result: FitResult) -> float:
    return max(abs(result.value[name] - true) for name, true in simulated.values.items())


def noise_of(simulated: Simulated, joints: float, point: float) -> Noise:
    outputs = simulated.truth.outputs
    return Noise({q: point if q in outputs else joints for q in simulated.exact})


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", range(5))
def test_least_squares_recovers_the_parameters_to_1e_12(name: str, seed: int) -> None:
    simulated = ARMS[name]
    start = simulated.off(5e-3, 0.02, seed=seed)
    # Once per arm the file is searched for faults too, which costs ten times the fit.
    result = calibrate(
        start, simulated.read(), method="least-squares", start="nominal", trusted=seed > 0
    )
    assert result.status.converged
    assert worst_error(simulated, result) <= 1e-12
    assert result.closure_after.max <= 1e-14


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("sd", [1e-6, 1e-5, 1e-3, 1e-1, 1.0])
def test_the_implicit_loop_with_exact_joints_recovers_them_with_any_sd_of_the_point(
    name: str, sd: float
) -> None:
    simulated = ARMS[name]
    start = simulated.off(5e-3, 0.02, seed=1)
    noise, trusted = noise_of(simulated, joints=0.0, point=sd), sd != 1e-3
    result = calibrate(start, simulated.read(), noise=noise, start="nominal", trusted=trusted)
    assert result.status.converged
    assert worst_error(simulated, result) <= 1e-12
    assert result.closure_after.max <= 1e-14
    assert all(np.all(result.corrections[q] == 0) for q in simulated.exact if "theta" in q)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("sd", [1e-6, 1e-3, 1e-1])
def test_with_uncertain_joints_too_exact_readings_need_no_correction(name: str, sd: float) -> None:
    simulated = ARMS[name]
    start = simulated.off(5e-3, 0.02, seed=2)
    noise, trusted = noise_of(simulated, joints=sd, point=sd), sd != 1e-3
    result = calibrate(start, simulated.read(), noise=noise, start="nominal", trusted=trusted)
    assert result.status.converged
    assert worst_error(simulated, result) <= 1e-11
    assert result.closure_after.max <= 1e-14
    assert max(abs(c).max() for c in result.corrections.values()) <= 1e-11


@pytest.mark.parametrize("name", ["dh", "mdh"])
def test_other_conventions_recover_what_is_determined(name: str) -> None:
    """Their last frame and first offset hide behind tool and base: those are fixed here."""
    truth = MACHINES[name]
    hidden = {
        "dh": ["a_6", "d_6", "alpha_6", "offset_6", "base_rz", "base_z"],
        "mdh": ["a_1", "d_1", "alpha_1", "offset_1", "d_6", "offset_6"],
    }[name]
    truth = truth.with_parameters(truth.parameters.with_fixed(hidden))
    joints = np.random.default_rng(4).uniform(-2.5, 2.5, (6, 80))
    simulated = arm_at(truth, joints)
    start = simulated.off(3e-3, 5e-3, seed=3)
    start = start.with_nominal({key: simulated.values[key] for key in hidden})
    result = calibrate(start, simulated.read(), method="least-squares", start="nominal")
    assert result.status.converged
    assert result.identifiability.rank == len(result.estimated)
    assert worst_error(simulated, result) <= 1e-12
