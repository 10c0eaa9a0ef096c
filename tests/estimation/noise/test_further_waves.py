"""Waves that a smooth discrepancy leaves out are errors that neighbouring poses share."""

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_worlds import World
from analyses.smooth_errors import shifted, smooth
from loopcal.estimation.noise.kenward_roger import _gained, _Sums, gains_by_waves
from loopcal.mechanisms.structure.smooth import Smooth


def _rows(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """D (120, 12) with D^T D + P = I, Z (120, 8), and a root of P."""
    t = rng.uniform(0.0, 6.0, 120)
    J = np.column_stack([np.cos(k * t + 0.3 * k) for k in range(12)])
    prior = np.diag(np.linspace(0.0, 4.0, 12))
    root = np.linalg.inv(np.linalg.cholesky(J.T @ J + prior)).T
    # the waves that follow are not orthogonal to those of the fit at these poses
    Z = np.column_stack([np.cos((k + 0.5) * t) for k in range(8, 16)]) / np.sqrt(8)
    return J @ root, Z, np.sqrt(prior) @ root


def _told(D: np.ndarray, Z: np.ndarray, e: np.ndarray) -> np.ndarray:
    found = _gained(_Sums(D.T @ Z, Z.T @ Z, Z.T @ e), D.T @ D, float(e @ e), len(e))
    return np.zeros((D.shape[1], D.shape[1])) if found is None else found.matrix


def test_the_covariance_is_that_of_fits_whose_errors_neighbours_share() -> None:
    rng = np.random.default_rng(1)
    D, Z, P = _rows(rng)
    tau = 1.5
    off, gained = [], []
    for _ in range(1500):
        v, b, u = rng.standard_normal(120), rng.standard_normal(8), rng.standard_normal(12)
        e = v + tau * Z @ b
        z = D.T @ e + P.T @ u  # the errors of the estimates
        off.append(z)
        gained.append(_told(D, Z, e - D @ z))
    true = np.cov(np.array(off).T)
    told = np.eye(12) + np.mean(gained, axis=0)
    assert np.trace(true) > 1.15 * 12  # else there is nothing to tell
    error = np.abs(true - told).max() / np.diag(true).max()
    assert error < 0.1


def test_independent_errors_gain_next_to_nothing() -> None:
    rng = np.random.default_rng(2)
    D, Z, P = _rows(rng)
    gained = []
    for _ in range(600):
        e = rng.standard_normal(120)
        z = D.T @ e + P.T @ rng.standard_normal(12)
        gained.append(float(np.trace(_told(D, Z, e - D @ z))))
    assert -0.2 < np.mean(gained) / 12 < 0.02


def test_smooth_errors_widen_the_regions_where_no_pose_was_measured() -> None:
    trial, _ = shifted(
        World(poses=150).made(np.random.default_rng(3)), 1.0, np.random.default_rng(4)
    )
    result = lc.calibrate(
        trial.mechanism,
        trial.readings,
        noise=trial.noise,
        method="least-squares",
        model_error="structured",
    )
    problem, root = result.problem, result.spectrum.root
    at = result.solution.corrections, result.pose_equations(), root
    ((_, gained),) = gains_by_waves(problem, *at)
    assert np.linalg.eigvalsh(np.eye(len(gained)) + gained).min() > 0.0
    plain = root @ root.T
    waves = [i for i, name in enumerate(result.estimated) if name.startswith("discrepancy_")]
    assert np.diag(result.covariance)[waves].sum() > 1.1 * np.diag(plain)[waves].sum()


@pytest.mark.parametrize("scale", [0.3, 1.0])
def test_what_the_parameters_took_up_is_no_error_between_the_poses(
    scale: float, tmp_path: Path
) -> None:
    """Measured in a corner, where waves and parameters do nearly the same."""
    rng = np.random.default_rng([71000, 3])
    trial = World(poses=150, share=0.15).made(rng)
    outputs = trial.inside.outputs
    joints = [q for q in trial.inside.readings if q not in outputs]
    shift = smooth(scale, len(joints), rng)

    def with_errors(outputs_of: dict[str, np.ndarray], at: dict[str, np.ndarray]) -> np.ndarray:
        off = shift(np.column_stack([at[q] for q in joints]))
        return np.column_stack([outputs_of[q] for q in outputs]) + off

    measured = with_errors(trial.readings, trial.readings)
    readings = trial.readings | dict(zip(outputs, measured.T, strict=True))
    true = dict(zip(outputs, trial.inside.true.T, strict=True))
    result = lc.calibrate(
        trial.mechanism,
        readings,
        noise=trial.noise,
        method="least-squares",
        model_error="structured",
    )
    assert not lc.predict(result, {q: readings[q] for q in joints}).extrapolated.any()
    predicted = lc.predict(result, trial.inside.readings)
    off = np.column_stack([predicted.outputs[q] for q in outputs])
    off -= with_errors(true, trial.inside.readings)
    stated = np.einsum("nii->n", predicted.covariance).mean()
    ratio = np.sqrt(np.square(off).sum(axis=1).mean() / stated)
    assert 0.7 < ratio < 1.3
    # and as much is stated of the result that was saved
    result.save(tmp_path / "saved")
    again = lc.read_result(tmp_path / "saved").predict(trial.inside.readings)
    assert again.covariance == pytest.approx(predicted.covariance, rel=1e-6, abs=1e-18)


def test_without_a_discrepancy_nothing_is_gained() -> None:
    trial = World(poses=40).made(np.random.default_rng(5))
    result = lc.calibrate(
        trial.mechanism, trial.readings, noise=trial.noise, method="least-squares"
    )
    at = result.solution.corrections, result.pose_equations(), result.spectrum.root
    assert gains_by_waves(result.problem, *at) == ()


@pytest.mark.parametrize("count", [12, 30])
def test_the_waves_that_follow_are_none_of_those_before(count: int) -> None:
    own = Smooth.of([(f"q{i}", "rad") for i in range(6)], {}, count)
    following = own.following(60)
    every = [h.orders for h in (*own.harmonics, *following.harmonics)]
    assert len(every) == len(set(every)) == 60
