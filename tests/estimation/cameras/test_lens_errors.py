"""Lenses that no model describes: the stated sds hold the best lens, and stay where there is none.

The true lens is a brown5 and a field of waves over the image. The best lens is that which fits both
over a grid of the whole image.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.dependence.dependence import LEVEL, likenesses
from loopcal.estimation.dependence.lens_errors import _eyes, _Sums
from loopcal.estimation.dependence.lens_errors import waves as stated_waves
from loopcal.estimation.fit import Fit
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.cameras.lens import project
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.comparison import covariance_between
from loopcal.statistics.images import halves_apart
from loopcal.statistics.lens_fields import LensField, lens_fields
from loopcal.statistics.sound import SOUND
from tests.estimation.cameras.test_image_errors import Array, placed, stated

WIDTH, HEIGHT = 1280, 960
LENS = {"f": 1100.0, "aspect": 0.0, "cx": 640.0, "cy": 480.0}
LENS |= {"k1": -0.1, "k2": 0.05, "p1": 0.0, "p2": 0.0, "k3": 0.0}
POINTS = {str(i): (0.03 * (i % 7) - 0.09, 0.03 * (i // 7) - 0.06, 0.0) for i in range(35)}
NAMES = tuple(f"eye:board:{point}:{axis}" for point in POINTS for axis in "uv")
EYE = (0.05, -0.02, 0.6, 0.3, 0.1, 3.0)
SIX = ("x", "y", "z", "rz", "ry", "rx")
CORNER, FIELD = 0.2, 0.5
FIT = Fit(method="implicit-loop", start="nominal")
WAVES = [(m, n) for m in range(4) for n in range(4) if m + n]


def machine() -> lc.Mechanism:
    nominal = {f"board_{n}": 0.0 for n in SIX}
    nominal |= {f"eye_{n}": v for n, v in zip(SIX, EYE, strict=True)}
    nominal |= {f"eye_{n}": v for n, v in LENS.items()}
    look = lc.instruments.camera("eye", points=POINTS, lens="brown5", image=(WIDTH, HEIGHT))
    return lc.assemble(lc.machines.free_body(), [look], nominal)


MACHINE = machine()
NOISE = lc.Noise(
    {"[xyz]": 1e-4, "w[xyz]": 1e-4, "eye": CORNER},
    estimate={"[xyz]": "group", "w[xyz]": "group", "eye": "group"},
)


def waves(uv: Array) -> Array:
    """(w, N) at pixels (2, N), smoother ones larger."""
    x, y = np.pi * uv[0] / WIDTH, np.pi * uv[1] / HEIGHT
    return np.array([np.cos(m * x + n) * np.cos(n * y + m) / (m**2 + n**2) for m, n in WAVES])


def pixels(X: Array, values: dict[str, float]) -> Array:
    return np.array(project("brown5", (X[0], X[1], X[2]), values))


def rays() -> Array:
    """(3, N) of a grid over the whole image."""
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 50), np.linspace(-0.5, 0.5, 40))
    X = np.array([x.ravel(), y.ravel(), np.ones(x.size)])
    u, v = pixels(X, LENS)
    return X[:, (u >= 0.0) & (u < WIDTH) & (v >= 0.0) & (v < HEIGHT)]


RAYS = rays()
STEP = {name: 1e-4 * max(1.0, abs(value)) for name, value in LENS.items()}
TANGENTS = np.column_stack(
    [
        (pixels(RAYS, LENS | {n: v + STEP[n]}) - pixels(RAYS, LENS | {n: v - STEP[n]})).ravel()
        / (2.0 * STEP[n])
        for n, v in LENS.items()
    ]
)


def field(random: np.random.Generator) -> tuple[Array, dict[str, float]]:
    """Amplitudes (2, w) of a field, and the lens that fits it best; it leaves `FIELD` px."""
    b = random.standard_normal((2, len(WAVES)))
    d = (b @ waves(pixels(RAYS, LENS))).ravel()
    step = np.linalg.lstsq(TANGENTS, d, rcond=None)[0]
    factor = FIELD / np.sqrt(np.square(d - TANGENTS @ step).mean())
    best = {n: v + factor * s for (n, v), s in zip(LENS.items(), step, strict=True)}
    return factor * b, best


def images(
    random: np.random.Generator,
    b: Array,
    best: dict[str, float],
    count: int = 20,
    pairs: bool = False,
) -> tuple[Array, Array, float]:
    """Poses of the board (N, 4, 4), their pixels without noise, and what the best lens leaves;
    pairs: poses of the second half stand near those of the first."""
    xyz = np.array(list(POINTS.values())).T
    inside = np.linalg.inv(placed(EYE))
    T: list[Array] = []
    uv: list[Array] = []
    left: list[Array] = []
    while len(T) < count:
        C = np.eye(4)
        tilt = random.uniform(0.2, 0.7) * np.array([*random.standard_normal(2), 0.0])
        C[:3, :3] = Rotation.from_rotvec(tilt).as_matrix() @ np.diag([1.0, -1.0, -1.0])
        C[:3, 3] = random.uniform((-0.2, -0.15, 0.35), (0.2, 0.15, 0.6))
        if pairs and len(T) >= count // 2:
            C = placed(EYE) @ T[len(T) - count // 2]
            C[:3, 3] += random.uniform(-5e-3, 5e-3, 3)
        X = C[:3, :3] @ xyz + C[:3, 3:]
        p = pixels(X, LENS)
        p = p + b @ waves(p)
        if (p > 0.0).all() and (p < np.array([[WIDTH], [HEIGHT]])).all():
            T.append(inside @ C)
            uv.append(p.T.ravel())
            left.append(p - pixels(X, best))
    return np.array(T), np.array(uv).T, float(np.sqrt(np.square(left).mean()))


class Draw(NamedTuple):
    """A calibration, the best lens, and what this leaves at the corners (rms) [px]."""

    result: FitResult
    best: dict[str, float]
    left: float


def calibrated(seed: int, *, odd: bool, day: int = 0, pairs: bool = False) -> Draw:
    """Of poses of a robot and images; odd: with a field; day: of the images of one lens."""
    random = np.random.default_rng(seed)
    b, best = field(random)
    if day:
        random = np.random.default_rng([seed, day])
    if not odd:
        b, best = 0.0 * b, LENS
    T, uv, left = images(random, b, best, 60 if pairs else 20, pairs)
    uv = uv + random.normal(0.0, CORNER, uv.shape)
    off = T.copy()
    turns = Rotation.from_rotvec(random.normal(0.0, 1e-4, (len(T), 3))).as_matrix()
    off[:, :3, :3] = turns @ T[:, :3, :3]
    off[:, :3, 3] += random.normal(0.0, 1e-4, (len(T), 3))
    data = lc.Dataset.from_arrays(stated(off) | dict(zip(NAMES, uv, strict=True)))
    return Draw(calibrate(MACHINE, data, noise=NOISE, fit=FIT), best, left)


def by_corners(result: FitResult) -> Array:
    """Sds of the estimate without what the lens leaves."""
    assert result.lens_errors is not None
    return np.sqrt(np.diag(result.covariance - result.lens_errors.covariance))


@pytest.fixture(scope="module")
def draws() -> list[Draw]:
    return [calibrated(seed, odd=True) for seed in range(12)]


LOOKED_AT = ("eye_f", "eye_cx", "eye_cy", "eye_k1")


def test_the_best_lens_is_within_its_sds_where_no_model_describes_it(
    draws: list[Draw],
) -> None:
    off, plain = [], []
    for result, best, _ in draws:
        sds = dict(zip(result.estimated, by_corners(result), strict=True))
        for name in LOOKED_AT:
            error = result.value[name] - best[name.removeprefix("eye_")]
            off.append(error / (result.sd[name] or np.nan))
            plain.append(error / sds[name])
    # 12 draws of 4 numbers that hang together: some 30 independent ones, of which 8 sds are 5 %.
    assert np.mean(np.abs(off) < 1.96) >= 0.85
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4
    assert np.sqrt(np.mean(np.square(plain))) > 2.0


def test_its_size_is_what_the_lens_leaves_at_the_corners(draws: list[Draw]) -> None:
    ratios = []
    for result, _, left in draws:
        assert result.lens_errors is not None
        (entry,) = result.lens_errors.entries
        assert entry.gain > 50.0
        ratios.append(entry.rms / left)
    # places of robot and board hide a part of it
    assert 0.5 < np.median(ratios) < 1.2
    assert min(ratios) > 0.3
    assert max(ratios) < 1.5


def test_the_document_says_so(draws: list[Draw]) -> None:
    document = fit_document(draws[0].result)
    facts = [one for one in (of(document) for of in SOUND) if one is not None]
    assert "lens-leaves-error" in [one.code for one in facts]


def test_sds_stay_where_the_model_describes_the_lens() -> None:
    ratios = []
    for seed in range(8):
        result = calibrated(seed, odd=False).result
        ratios.append(np.sqrt(np.diag(result.covariance)) / by_corners(result))
        document = fit_document(result)
        facts = [one for one in (of(document) for of in SOUND) if one is not None]
        assert "lens-leaves-error" not in [one.code for one in facts]
    assert np.median(ratios) < 1.02
    assert np.mean(ratios) < 1.05


def test_waves_explain_no_more_of_noise_than_as_many_columns_do() -> None:
    """Waves at noisy pixels, less a lens at its own, are the noise: they explained all of it."""
    for seed in range(3):
        result = calibrated(seed, odd=False).result
        at = result.solution.parameters, result.solution.corrections
        eyes = _eyes(result.problem, at[0])
        sums = _Sums.of(result.problem, *at, eyes)
        both = np.block([[sums.DD, sums.DZ], [sums.DZ.T, sums.ZZ]])
        rows, n = np.concatenate([sums.DE, sums.ZE]), len(sums.DE)
        scale = 1.0 / np.sqrt(np.diag(both))
        all_of_it, by_lens = (
            (scale * rows)[part]
            @ np.linalg.pinv((both * scale * scale[:, None])[part, part], 1e-12, hermitian=True)
            @ (scale * rows)[part]
            for part in (slice(None), slice(n))
        )
        columns = sums.ZZ.shape[0]
        assert all_of_it - by_lens < columns + 5.0 * np.sqrt(2.0 * columns)


def test_halves_of_the_images_share_what_no_model_describes(draws: list[Draw]) -> None:
    off: list[float] = []
    for result, _, _ in draws[:10]:
        halves = (
            calibrate(MACHINE, result.dataset.take(slice(first, None, 2)), noise=NOISE, fit=FIT)
            for first in (0, 1)
        )
        apart = {one.name: one.sds for one in halves_apart(result, *halves)}
        off += [apart[f"eye_{name}"] for name in ("cx", "cy", "p1", "p2")]
    # counted in each half as if the other had another field: 0.60
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.2
    assert np.abs(off).max() < 3.0


def test_two_days_of_one_lens_share_what_no_model_describes(draws: list[Draw]) -> None:
    off = []
    for seed, draw in enumerate(draws[:8]):
        results = draw.result, calibrated(seed, odd=True, day=1).result
        first, second = (Calibrated.of(one, "") for one in results)
        C = covariance_between(first, second)
        sds = np.sqrt(np.diag(C.matrix))
        for i, name in enumerate(results[0].mechanism.parameters.names):
            if name in ("eye_cx", "eye_cy", "eye_p1", "eye_p2"):
                off.append((results[1].value[name] - results[0].value[name]) / sds[i])
    # Fields counted in each day as if the other had another lens make this too small.
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.abs(off).max() < 3.5


def test_a_document_holds_how_the_field_moves_the_parameters(draws: list[Draw]) -> None:
    result = draws[0].result
    assert result.lens_errors is not None
    (one,) = lens_fields(fit_document(result).lens_errors, np.eye(len(result.estimated)))
    np.testing.assert_allclose(one.covariance, result.lens_errors.covariance)


def test_a_field_over_an_image_of_another_size_is_the_same_field() -> None:
    """Each parameter is here what the field is at a pixel."""
    u, v = np.array([[100.0, 640.0, 1200.0, 900.0], [50.0, 480.0, 900.0, 200.0]])
    small, large = (1280.0, 960.0), (1400.0, 1000.0)
    of_small, of_large = (stated_waves(u / w, v / h).T for w, h in (small, large))
    one = LensField("eye", large, np.ones(72), np.asarray(np.kron(np.eye(2), of_large)))
    smooth = np.tile(np.arange(36) % 6 + np.arange(36) // 6 < 4, 2)
    there = one.over(small)[:, smooth]
    np.testing.assert_allclose(there, np.kron(np.eye(2), of_small)[:, smooth], atol=0.03)
    assert one.over(large) is one.moved


@pytest.mark.parametrize("seed", range(4))
def test_images_that_stand_alike_share_the_field_and_no_error_of_the_machine(seed: int) -> None:
    """Their residuals are alike, and without the field that the images show they are not."""
    result = calibrated(seed, odd=True, pairs=True).result
    bare = result.pose_equations(bare=True)

    def chance(equations: Sequence[PoseEquations]) -> float:
        (one,) = likenesses(result.problem, result.solution, equations).instruments
        assert one.spatial is not None
        return one.spatial.p_value

    assert chance(result.pose_equations()) < LEVEL
    assert chance(bare) > LEVEL
    assert result.dependence is not None
    assert not result.dependence.spatial
    # What parameters without a prior would take of the field is gone as well.
    pulls = [
        sum(np.einsum("brn,br->n", one.D, one.E) for one in equations)
        for equations in (bare, result.pose_equations())
    ]
    sds = np.sqrt(np.diag(result.spectrum.covariance()))
    taken = (sds * (pulls[0] - pulls[1]))[result.problem.precision == 0.0]
    assert np.abs(taken).max() < 1e-3


def test_without_a_field_the_residual_equations_are_those_of_the_fit() -> None:
    result = calibrated(0, odd=False).result
    for one, bare in zip(result.pose_equations(), result.pose_equations(bare=True), strict=True):
        assert np.array_equal(one.E, bare.E)
