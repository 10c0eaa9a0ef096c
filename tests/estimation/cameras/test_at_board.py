"""Where images put a board: shifts of it are recovered, with the noise that corners give them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.estimation.cameras.at_board import Sight, sights
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.cameras.lens import Intrinsics, project

Array = NDArray[np.float64]
POINTS = {str(i): (0.04 * (i % 4) - 0.06, 0.04 * (i // 4) - 0.04, 0.0) for i in range(12)}
LENS = Intrinsics("pinhole", 900.0, 900.0, 630.0, 470.0)
SIX = ("x", "y", "z", "rz", "ry", "rx")
FAR = {"left": (0.1, 0.0, 1.1, 0.0, 0.1, 3.0), "right": (-0.2, 0.1, 1.2, 0.1, -0.2, 3.1)}
SD = 0.3
COUNT = 40


def placed(numbers: tuple[float, ...]) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", numbers[3:]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def hands() -> Array:
    random = np.random.default_rng(5)
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(random.uniform(-0.4, 0.4, (COUNT, 3))).as_matrix()
    T[:, :3, 3] = random.uniform(-0.15, 0.15, (COUNT, 3))
    return T


def differences(
    T: Array, seen: Array, noise: float, *, corners: int = 12, later: float = 0.0
) -> tuple[tuple[Sight, ...], Array]:
    """Sights where the machine says T, and differences where the hand is at `seen`.

    later: by how much the left focal length is longer in the later half of the images [px].
    """
    X = np.array([(*p, 1.0) for p in POINTS.values()]).T
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
    table = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*T[:, :3, 3].T, *q), strict=True))
    nominal = {f"board_{n}": 0.0 for n in SIX}
    random = np.random.default_rng(8)
    for eye, place in FAR.items():
        P = (placed(place) @ seen @ X)[:, :3].transpose(1, 0, 2)
        uv = np.array(project(LENS.lens, P, LENS.values))
        uv += random.normal(0.0, noise, uv.shape)
        uv[:, :, corners:] = np.nan
        for k, point in enumerate(POINTS):
            for axis, values in zip("uv", uv[:, :, k], strict=True):
                table[f"{eye}:board:{point}:{axis}"] = values
        nominal |= {f"{eye}_{n}": v for n, v in zip(SIX, place, strict=True)}
        nominal |= {f"{eye}_{n}": v for n, v in LENS.values.items()}
    looks = [lc.instruments.camera(eye, points=POINTS, lens="pinhole") for eye in FAR]
    mechanism = lc.assemble(lc.machines.free_body(), looks, nominal)
    if later:
        change = lc.effects.Shift(("left_f",), (0.5 * COUNT,))
        mechanism = lc.with_effects(mechanism, [change]).with_nominal({"left_f_from20": later})
        table["pose"] = np.arange(COUNT)
    sds = {"[xyz]": 1e-4, "w?": 1e-4, **dict.fromkeys(FAR, SD)}
    problem = build_problem(mechanism, lc.Dataset.from_arrays(table), lc.Noise(sds))
    zero = np.zeros(problem.readings.shape)
    return sights(problem, problem.start, zero), output_differences(problem, problem.start)


def test_a_shift_of_the_board_is_seen_across_and_along_the_line_of_sight() -> None:
    T, shift = hands(), np.array([1e-4, -2e-4, 3e-4])
    seen = T.copy()
    seen[:, :3, 3] += shift
    made, apart = differences(T, seen, 0.0)
    assert [one.instrument for one in made] == ["left", "right", None]
    for sight in made:
        place = sight.place(apart)
        assert place is not None
        assert place.position is not None
        assert place.along is not None
        assert place.position.rms == pytest.approx(np.linalg.norm(shift), rel=0.01)
        assert np.hypot(place.across, place.along) == pytest.approx(place.position.rms, rel=1e-9)
        if sight.instrument is not None:
            eye = placed(FAR[sight.instrument])
            middle = (eye @ T)[:, :3, 3]
            sight_line = middle / np.linalg.norm(middle, axis=1)[:, None]
            along = sight_line @ eye[:3, :3] @ shift
            assert place.along == pytest.approx(np.sqrt(np.square(along).mean()), rel=0.02)


def test_noise_of_corners_alone_makes_the_shift_that_is_stated() -> None:
    made, apart = differences(hands(), hands(), SD)
    for sight in made:
        place = sight.place(apart)
        assert place is not None
        assert place.noise_across is not None
        assert place.along is not None
        assert place.noise_along is not None
        # An rms of 40 (80) normal errors is sure to 11 (8) %.
        assert place.across == pytest.approx(place.noise_across, rel=0.25)
        assert place.along == pytest.approx(place.noise_along, rel=0.35)
        # f = 900 px, 1.1 m: two directions of 0.3 px Z / f / sqrt(12 corners), or of 24.
        assert place.noise_across < np.sqrt(2.0) * SD * 1.2 / 900.0 / np.sqrt(12.0)
    # Two views from different directions say how far away the board is.
    assert np.nanmean(made[2].noise[:, 2]) < 0.7 * np.nanmean(made[0].noise[:, 2])  # type: ignore[index]


def test_one_corner_says_nothing_along_the_line_of_sight() -> None:
    made, apart = differences(hands(), hands(), SD, corners=1)
    place = made[0].place(apart)
    assert place is not None
    assert place.across > 0.0
    assert place.along is None
    assert place.position is None
    both = made[2].place(apart)
    assert both is not None
    assert both.position is not None


def test_sds_of_pixels_are_sds_of_the_board() -> None:
    T = hands()
    made, _ = differences(T, T, 0.0)
    covariance = SD**2 * np.eye(made[0].slopes.shape[2])[None].repeat(COUNT, axis=0)
    expected = np.sqrt(np.square(made[0].noise).sum(axis=1))  # type: ignore[arg-type]
    assert made[0].sds(covariance) == pytest.approx(expected, rel=1e-9)


def test_a_lens_that_changed_during_the_run_sees_by_what_it_is_then() -> None:
    T = hands()
    (plain, right, *_), _ = differences(T, T, 0.0)
    (changed, same, *_), _ = differences(T, T, 0.0, later=90.0)
    half = COUNT // 2
    assert changed.slopes[:half] == pytest.approx(plain.slopes[:half])
    assert changed.slopes[half:] == pytest.approx(plain.slopes[half:] / 1.1)
    assert same.slopes == pytest.approx(right.slopes)
