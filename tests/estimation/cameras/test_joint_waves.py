"""What errors that follow a joint add to the covariance of a fit that took them as noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.cameras import truth
from analyses.cameras_truth import shots
from loopcal.estimation.dependence.joint_waves import _ORDERS, _learnt
from loopcal.estimation.dependence.seen import Seen
from loopcal.estimation.result import FitResult

Array = NDArray[np.float64]


def draw(random: np.random.Generator, follows: float) -> tuple[float, float]:
    """By how many sds a parameter that joints stand in for is off, with independent errors and by
    `_learnt`; of 40 images of two joints whose errors have the variance 1. follows: the share that
    follows the joint."""
    N, q, k, m = 40, 2, 3, 6
    X, D = random.normal(size=(N, m, q)), random.normal(size=(N, m, k))
    angle = random.uniform(-1.5, 1.5, (N, q))
    D[:, :, 0] = np.einsum("nmq,nq->nm", X, np.sin(angle + np.arange(2.0)))
    phase = random.uniform(0.0, 2.0 * np.pi, q)
    u = np.sqrt(2.0 * follows) * np.sin(2.0 * angle + phase)
    u += np.sqrt(1.0 - follows) * random.normal(size=(N, q))
    E = np.einsum("nmq,nq->nm", X, u) + 0.3 * random.normal(size=(N, m))
    T = np.linalg.inv(np.linalg.cholesky(0.09 * np.eye(m) + X @ X.swapaxes(1, 2)))
    E, X, D = (T @ E[:, :, None])[:, :, 0], T @ X, T @ D
    H = np.einsum("nmi,nmj->ij", D, D)
    root = np.linalg.inv(np.linalg.cholesky(H)).T
    D = D @ root
    pushed = np.einsum("nmi,nm->i", D, E)
    Xt = X.swapaxes(1, 2)
    view = Seen((Xt @ E[:, :, None])[:, :, 0], Xt @ D, Xt @ X)
    waves = angle[:, :, None] * _ORDERS
    F = np.concatenate([np.cos(waves), np.sin(waves)], axis=2)
    C = root @ (np.eye(k) + _learnt(view, F, pushed).gained) @ root.T
    error = float((root @ pushed)[0])
    return error / float(np.sqrt((root @ root.T)[0, 0])), error / float(np.sqrt(C[0, 0]))


@pytest.mark.parametrize(("follows", "low", "high"), [(0.0, 0.9, 1.1), (0.8, 1.5, 4.0)])
def test_the_covariance_is_that_of_many_draws(follows: float, low: float, high: float) -> None:
    random = np.random.default_rng(3)
    z = np.array([draw(random, follows) for _ in range(300)])
    before, after = np.sqrt(np.mean(z**2, axis=0))
    assert low < before < high
    assert 0.7 < after < 1.1


def calibrated(folder: Path) -> tuple[FitResult, Array]:
    """Images by a camera on the hand of an arm with gears, and z of zeros and twists."""
    shot = shots(3, held=False)
    phase = np.arange(6.0)
    read = shot.read - 5e-4 * np.sin(shot.q + phase) - 3e-4 * np.sin(2.0 * (shot.q + phase))
    type(shot)(shot.rig, shot.q, read, shot.uv).write(folder)
    project = lc.init(folder, dh=folder / "dh.csv")
    found = lc.calibrate(
        project.mechanism, project.dataset, noise=project.noise, method="implicit-loop"
    )
    assert isinstance(found, FitResult)
    true = truth(shot.rig)
    names = [f"{p}_{j}" for p in ("offset", "alpha") for j in range(2, 6)]
    return found, np.array([(found.value[n] - true[n]) / (found.sd[n] or np.nan) for n in names])


def test_gears_widen_what_images_say_of_an_arm_and_predictions_leave_it_out(
    tmp_path: Path,
) -> None:
    found, z = calibrated(tmp_path)
    assert np.sqrt(np.mean(z**2)) < 1.6  # 3.9 where errors of joints count as noise
    part = found.pose_part
    assert part is not None
    i = list(found.estimated).index("cam_f")
    assert part[i, i] > 0.2 * found.covariance[i, i]
    assert found.smooth_errors is None
