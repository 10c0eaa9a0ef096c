"""Wrong corners leave their images in, an image in another order is one outlier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.cameras_truth import Shots, shots
from loopcal.measurements.dataset import Dataset
from loopcal.statistics.outlier_search import Search
from loopcal.statistics.wrong_corners import wrong_corners
from loopcal.workflow.beginning.initial import InitialProject

SEED = 3


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shots, InitialProject]:
    one = shots(SEED, held=True, images=12)
    folder: Path = tmp_path_factory.mktemp("images")
    one.write(folder, T=one.rig.flange(one.read))
    return one, lc.init(folder)


def _fit(project: InitialProject, data: Dataset) -> lc.Result:
    return lc.calibrate(
        project.mechanism, data, noise=lc.Noise(project.noise.entries), method="implicit-loop"
    )


def _changed(data: Dataset, uv: np.ndarray) -> Dataset:
    """uv (N, n, 2)"""
    names = [(k, axis) for k in range(uv.shape[1]) for axis in (0, 1)]
    return data.with_readings({f"cam:board:{k}:{'uv'[a]}": uv[:, k, a] for k, a in names})


def test_no_corner_of_good_images_is_wrong(begun: tuple[Shots, InitialProject]) -> None:
    one, project = begun
    wrong = wrong_corners(_fit(project, project.dataset))
    assert not wrong.corners
    assert not wrong.images.any()
    assert wrong.sd["cam"] == pytest.approx(one.rig.corner, rel=0.1)


def test_a_tenth_of_the_corners_is_named_and_nothing_else(
    begun: tuple[Shots, InitialProject],
) -> None:
    one, project = begun
    rng = np.random.default_rng(5)
    uv, bad = one.uv.copy(), rng.random(one.uv.shape[:2]) < 0.1
    uv[bad] += rng.choice([-1.0, 1.0], (int(bad.sum()), 2)) * rng.uniform(3.0, 50.0, (bad.sum(), 2))
    result = _fit(project, _changed(project.dataset, uv))
    wrong = wrong_corners(result)
    names = list(result.problem.mechanism.tape.quantities)
    rows = [names.index(f"cam:board:{k}:u") for k in range(uv.shape[1])]
    np.testing.assert_array_equal(wrong.single[rows].T, bad)
    outliers = lc.find_outliers(result)
    assert len(outliers) == int(bad.sum())
    assert {one.unit for one in outliers.found} == {"px"}


def test_an_image_in_another_order_is_one_outlier(begun: tuple[Shots, InitialProject]) -> None:
    one, project = begun
    uv = one.uv.copy()
    uv[7] = uv[7, ::-1]
    outliers = lc.find_outliers(_fit(project, _changed(project.dataset, uv)))
    assert [(one.pose, one.quantity) for one in outliers.found] == [("8", None)]
    assert "another order" in (outliers.found[0].cause or "")


def test_blurred_images_are_no_outliers_but_one_in_another_order_is(
    begun: tuple[Shots, InitialProject],
) -> None:
    one, project = begun
    rng = np.random.default_rng(6)
    pixels = one.rig.pixels(one.rig.flange(one.q))
    blur = np.exp(np.linspace(-0.7, 0.7, len(pixels)))[rng.permutation(len(pixels)), None, None]
    uv = pixels + one.rig.corner * blur * rng.normal(size=pixels.shape)
    assert not lc.find_outliers(_fit(project, _changed(project.dataset, uv))).found
    uv[7] = uv[7, ::-1]
    outliers = lc.find_outliers(_fit(project, _changed(project.dataset, uv)))
    assert [(one.pose, one.quantity) for one in outliers.found] == [("8", None)]


def test_corners_that_were_not_detected_are_no_equations(
    begun: tuple[Shots, InitialProject],
) -> None:
    one, project = begun
    uv = one.uv.copy()
    uv[3, 4:] = np.nan
    result = _fit(project, _changed(project.dataset, uv))
    search = Search(result, 0.05, "auto")
    _, _, tests = search.run()
    points = uv.shape[1]
    assert tests.freedom.tolist() == [2 * (4 if i == 3 else points) for i in range(len(uv))]


def test_images_with_wrong_corners_are_named(tmp_path: Path) -> None:
    one = shots(SEED, held=True, images=12)
    uv = one.uv.copy()
    uv[7, 3] += 20.0
    one.write(tmp_path, uv=uv, T=one.rig.flange(one.read))
    (words,) = [text for text in lc.init(tmp_path).remarks if "Left out" in text]
    assert "Left out 1 of 576 corners, in 1 of 12 images (8): " in words
