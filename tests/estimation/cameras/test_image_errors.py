"""Least squares on images whose poses err: stated sds hold the truth, and stay where none do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.mechanisms.cameras.lens import Intrinsics, project
from loopcal.small_samples import f_limit, t_quantile

Array = NDArray[np.float64]
POINTS = {str(i): (0.04 * (i % 4) - 0.06, 0.04 * (i // 4) - 0.04, 0.0) for i in range(12)}
NAMES = tuple(f"eye:board:{point}:{axis}" for point in POINTS for axis in "uv")
LENS = Intrinsics("pinhole", 900.0, 900.0, 630.0, 470.0)
SIX = ("x", "y", "z", "rz", "ry", "rx")
EYE = (0.1, 0.0, 1.1, 0.0, 0.1, 3.0)
CORNER = 0.2


def placed(numbers: tuple[float, ...]) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", numbers[3:]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def mechanism() -> lc.Mechanism:
    nominal = {f"board_{n}": 0.0 for n in SIX}
    nominal |= {f"eye_{n}": v for n, v in zip(SIX, EYE, strict=True)}
    nominal |= {f"eye_{n}": v for n, v in LENS.values.items()}
    look = lc.instruments.camera("eye", points=POINTS, lens="pinhole")
    return lc.assemble(lc.machines.free_body(), [look], nominal)


def poses(random: np.random.Generator, count: int) -> Array:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(random.uniform(-0.5, 0.5, (count, 3))).as_matrix()
    T[:, :3, 3] = random.uniform(-0.15, 0.15, (count, 3))
    return T


def images(T: Array) -> Array:
    """(48, N) true pixels of these poses."""
    X = np.array([(*p, 1.0) for p in POINTS.values()]).T
    uv = np.array(project(LENS.lens, (placed(EYE) @ T @ X)[:, :3].transpose(1, 0, 2), LENS.values))
    return uv.transpose(2, 0, 1).reshape(len(NAMES), -1)


def stated(T: Array) -> dict[str, Array]:
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
    return dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*T[:, :3, 3].T, *q), strict=True))


def moved(T: Array, random: np.random.Generator, size: float) -> Array:
    """These poses with errors of this size [m, rad] each."""
    off = T.copy()
    off[:, :3, :3] = (
        Rotation.from_rotvec(random.normal(0.0, size, (len(T), 3))).as_matrix() @ T[:, :3, :3]
    )
    off[:, :3, 3] += random.normal(0.0, size, (len(T), 3))
    return off


MACHINE = mechanism()


def calibrated(random: np.random.Generator, size: float, count: int = 30) -> Any:
    T = poses(random, count)
    uv = images(moved(T, random, size))
    uv += random.normal(0.0, CORNER, uv.shape)
    table = stated(T) | dict(zip(NAMES, uv, strict=True))
    data = lc.Dataset.from_arrays(table)
    return calibrate(MACHINE, data, fit=Fit(method="least-squares", start="nominal"))


@pytest.fixture(scope="module")
def draws() -> list[tuple[float, bool, float, float]]:
    """Of each draw: (f - true) / sd, whether its interval holds it, the share of fresh poses whose
    first corner lies in its region, and the rms of all pixels over the one stated."""
    made = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        result = calibrated(random, 1e-3)
        sd, nu = result.sd["eye_f"], result.degrees_of_freedom["eye_f"]
        off = (result.value["eye_f"] - LENS.values["f"]) / sd
        fresh = poses(random, 4)
        said = lc.predict(result, stated(fresh))
        d = images(moved(fresh, random, 1e-3)) - np.array([said.outputs[q] for q in NAMES])
        C = said.covariance[:, :2, :2]
        inside = np.einsum("in,nij,jn->n", d[:2], np.linalg.inv(C), d[:2])
        held = inside <= f_limit(0.95, 2, said.freedom[:, 0])
        rms = np.sqrt(np.square(d).mean() / np.einsum("nii->ni", said.covariance).mean())
        made.append((off, abs(off) <= t_quantile(0.95, nu), held.mean(), rms))
    return made


def test_intervals_of_the_lens_hold_it_where_poses_err(
    draws: list[tuple[float, bool, float, float]],
) -> None:
    # 60 draws: 3 sds of a share of 0.95 are 0.084.
    assert np.mean([one[1] for one in draws]) >= 0.866
    assert 0.75 < np.sqrt(np.mean([one[0] ** 2 for one in draws])) < 1.4


def test_regions_of_predicted_corners_hold_them_where_poses_err(
    draws: list[tuple[float, bool, float, float]],
) -> None:
    assert 0.88 <= np.mean([one[2] for one in draws]) <= 0.99
    assert np.mean([one[3] for one in draws]) == pytest.approx(1.0, abs=0.12)


def test_sds_stay_where_poses_do_not_err() -> None:
    ratios = []
    for seed in range(12):
        result = calibrated(np.random.default_rng(100 + seed), 0.0)
        plain = np.diag(result._by_residuals().matrix)
        ratios.append(np.sqrt(np.diag(result.covariance) / plain))
    # Each varies by 1 / sqrt(2 x 27 degrees of freedom) = 14 %.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)


def test_a_saved_result_predicts_with_what_an_image_shares(tmp_path: Any) -> None:
    random = np.random.default_rng(7)
    result = lc.Result.of(calibrated(random, 1e-3))
    result.save(tmp_path)
    fresh = stated(poses(random, 2))
    one, other = (lc.predict(r, fresh) for r in (result, lc.load(tmp_path)))
    assert one.covariance[0, 0, 2] > 0.8 * one.covariance[0, 0, 0]  # corners beside each other
    assert other.covariance == pytest.approx(one.covariance, rel=1e-9)
    assert other.region() == pytest.approx(one.region(), rel=1e-9)


def test_few_images_have_none() -> None:
    assert calibrated(np.random.default_rng(1), 1e-3, 5).image_errors is None


def test_another_day_is_as_calibrated_and_a_lens_that_was_turned_is_not(tmp_path: Any) -> None:
    answers = []
    for seed in range(8):
        random = np.random.default_rng(50 + seed)
        result = lc.Result.of(calibrated(random, 1e-3))
        T = poses(random, 20)
        uv = images(moved(T, random, 1e-3)) + random.normal(0.0, CORNER, (len(NAMES), 20))
        turned = 1.1 * (uv - 550.0) + 550.0  # f + 10 %
        days = [stated(T) | dict(zip(NAMES, day, strict=True)) for day in (uv, turned)]
        if seed == 0:
            result.save(tmp_path)
            one, other = (lc.verify(r, days[0]) for r in (result, lc.load(tmp_path)))
            assert other.innovation.p_value == pytest.approx(one.innovation.p_value, rel=1e-6)
        answers.append([bool(lc.verify(result, day).verdict["consistent"].passed) for day in days])
    # Of 8 true ones at 1 % none, or one by chance.
    assert np.sum(answers, axis=0)[0] >= 7
    assert np.sum(answers, axis=0)[1] == 0
