"""Programs that share no line with the estimator reach the same parameters and sds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from tests.reference.lagrange import DenseLagrange, Stationary
from tests.reference.odr import ExplicitArm
from tests.reference.simulated import Simulated, away_from_zero, ma1400, planar_arm

Array = NDArray[np.float64]
NOISES = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2]
ARMS = {
    "planar": away_from_zero(planar_arm(100)),
    "MA1400": away_from_zero(ma1400(100)),
}


def sds_of(simulated: Simulated, level: float) -> dict[str, float]:
    """So much noise in the joints [rad], in the point a third of it [m]."""
    return {
        q: level if unit == "rad" else 0.3 * level for q, unit in simulated.truth.quantities.items()
    }


def nominal_of(machine: Mechanism) -> Array:
    return np.array([p.nominal for p in machine.parameters])


def values_of(result: FitResult) -> Array:
    return np.array(list(result.value.values()))


def sds_of_result(result: FitResult) -> Array:
    return np.array([math.nan if sd is None else sd for sd in result.sd.values()])


@pytest.mark.parametrize("level", NOISES)
@pytest.mark.parametrize("name", ARMS)
def test_odrpack_with_a_flat_prior(name: str, level: float) -> None:
    odrpack = pytest.importorskip("odrpack")
    simulated = ARMS[name]
    sds = sds_of(simulated, level)
    data = simulated.read(sds, seed=5)
    start = simulated.off(2e-3, 5e-3, seed=3)
    result = calibrate(start, data, noise=Noise(sds), start="nominal")
    assert result.status.converged
    # what odrpack itself may still be off has to be well within what is asked here
    largest = np.max(sds_of_result(result) / abs(values_of(result)))
    enough = 2e-10 / float(largest)
    oracle = ExplicitArm(simulated.truth, data, sds).solve(odrpack, nominal_of(start), enough)
    assert oracle.remaining <= enough
    assert values_of(result) == pytest.approx(oracle.beta, rel=1e-9, abs=0)
    assert sds_of_result(result) == pytest.approx(oracle.sd, rel=1e-6, abs=0)
    assert result.chi_squared is not None
    assert result.chi_squared.value == pytest.approx(oracle.merit, rel=1e-9)


def dense(machine: Mechanism, data: Dataset, precision: Array, prior_sds: Array) -> Stationary:
    readings = np.array([data[q] for q in machine.tape.quantities])
    prior = np.diag(prior_sds**-2.0)
    system = DenseLagrange(machine.tape, readings, precision, nominal_of(machine), prior)
    return system.solve(nominal_of(machine))


@pytest.mark.parametrize("tightness", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("level", [1e-6, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("name", ARMS)
def test_a_dense_lagrange_system_with_a_finite_prior(
    name: str, level: float, tightness: float
) -> None:
    simulated = ARMS[name]
    sds = sds_of(simulated, level)
    data = simulated.read(sds, seed=6).take(slice(0, 25))
    start = simulated.off(2e-3, 5e-3, seed=7)
    sizes = {p.name: tightness * (2e-3 if p.unit == "m" else 5e-3) for p in start.parameters}
    result = calibrate(start, data, noise=Noise(sds), prior=Prior(sizes), start="nominal")
    assert result.status.converged
    precision = np.diag([sds[q] ** -2.0 for q in start.tape.quantities])
    oracle = dense(start, data, precision, np.array(list(sizes.values())))
    assert oracle.change <= 1e-13
    assert values_of(result) == pytest.approx(oracle.parameters, rel=1e-10, abs=0)
    corrections = np.array(list(result.corrections.values()))
    assert corrections == pytest.approx(oracle.corrections, rel=1e-10, abs=1e-12)
    assert result.chi_squared is not None
    assert result.chi_squared.value == pytest.approx(oracle.merit, rel=1e-9)
    # the dense inverse loses digits as (prior sd over posterior sd) squared
    sd = sds_of_result(result)
    deviation = abs(result.covariance - oracle.covariance) / np.outer(sd, sd)
    assert deviation.max() <= (1e-5 if level < 1e-4 else 1e-8)


@pytest.mark.parametrize("name", ARMS)
def test_a_dense_lagrange_system_with_full_covariances_per_pose(name: str) -> None:
    simulated = ARMS[name]
    quantities = simulated.truth.tape.quantities
    sds = np.array([sds_of(simulated, 1e-3)[q] for q in quantities])
    data = simulated.read(sds_of(simulated, 1e-3), seed=8).take(slice(0, 25))
    rng = np.random.default_rng(9)
    roots = rng.normal(size=(25, len(sds), len(sds))) / math.sqrt(len(sds))
    covariances = np.einsum("i,bij,bkj,k->bik", sds, roots, roots, sds)
    start = simulated.off(2e-3, 5e-3, seed=7)
    sizes = {p.name: 2e-3 if p.unit == "m" else 5e-3 for p in start.parameters}
    noise = Noise({quantities: covariances})
    result = calibrate(start, data, noise=noise, prior=Prior(sizes), start="nominal")
    assert result.status.converged
    oracle = dense(start, data, np.linalg.inv(covariances), np.array(list(sizes.values())))
    assert oracle.change <= 1e-12
    assert values_of(result) == pytest.approx(oracle.parameters, rel=1e-10, abs=0)
    sd = sds_of_result(result)
    assert np.all(abs(result.covariance - oracle.covariance) <= 1e-7 * np.outer(sd, sd))
