"""Offsets of the points of a print: learnt where images ask for them, as if each were free."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvalsh

import loopcal as lc
from analyses.cameras_truth import COLUMNS, ROWS, Rig, Shots, poses, rig
from loopcal.arrays import Array
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.terms import Term
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.printed import Offsets

IMAGES = 20


@dataclass(frozen=True, eq=False)
class Printed(Rig):
    """A rig whose board has points that are off (n, 3) [m]."""

    off: Array = field(kw_only=True)

    @property
    def print(self) -> Array:
        return super().print + self.off


def _shots(off: Array, number: int = 3) -> Shots:
    rng = np.random.default_rng([91, number])
    one = rig(number, True, rng)
    one = Printed(**{f.name: getattr(one, f.name) for f in fields(Rig)}, off=off)
    q = poses(one, IMAGES, rng)
    uv = one.pixels(one.flange(q))
    uv = uv + one.corner * rng.normal(size=uv.shape)
    return Shots(one, q, q + one.encoder * rng.normal(size=q.shape), uv)


def _project(shots: Shots, folder: Path) -> lc.InitialProject:
    shots.write(folder, T=shots.rig.flange(shots.read))
    return lc.init(folder)


def _calibrated(shots: Shots, folder: Path) -> FitResult:
    project = _project(shots, folder)
    return lc.calibrate(
        project.mechanism, project.dataset, noise=project.noise, method="implicit-loop"
    )


@pytest.fixture(scope="module")
def scattered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shots, FitResult]:
    off = np.random.default_rng(7).normal(0.0, 1.5e-4, (COLUMNS * ROWS, 3)) * [1.0, 1.0, 0.0]
    shots = _shots(off)
    return shots, _calibrated(shots, tmp_path_factory.mktemp("scattered"))


def test_a_perfect_print_has_no_offsets(tmp_path: Path) -> None:
    result = _calibrated(_shots(np.zeros((COLUMNS * ROWS, 3))), tmp_path)
    assert result.terms == ()
    assert not result.learns_terms
    corners = result.mechanism.parameters.of_role("corner")
    assert len(corners) == 3 * COLUMNS * ROWS
    assert {result.value[name] for name in corners} == {0.0}


def test_scattered_points_are_learnt_with_their_sd(scattered: tuple[Shots, FitResult]) -> None:
    shots, result = scattered
    (points,) = result.terms
    assert points.name == "points"
    assert points.gain is not None
    assert points.gain > 100.0
    low, high = points.interval or (0.0, 0.0)
    assert low < 1.5e-4 < (high or 0.0)
    (sd,) = [entry.sd for entry in result.noise if entry.quantities[0].startswith("cam")]
    assert sd == pytest.approx(shots.rig.corner, rel=0.05)
    assert len(lc.find_outliers(result)) == 0


def _sds(predicted: lc.Prediction) -> Array:
    """(N, o) by the parameters, of pixels beside what all of an image share."""
    C = predicted.from_parameters
    k = C.shape[1] // 2
    alone = np.eye(2 * k) - np.kron(np.full((k, k), 1.0 / k), np.eye(2))
    return np.asarray(np.sqrt(np.einsum("ij,njk,ki->ni", alone, C, alone)))


def test_they_are_those_of_offsets_that_are_free(scattered: tuple[Shots, FitResult]) -> None:
    _, result = scattered
    (points,) = result.terms
    mechanism = result.mechanism
    names = [n for n in mechanism.parameters.of_role("corner") if not n.endswith("_z")]
    items = [
        replace(p, fixed=False, role="print") if p.name in names else p
        for p in mechanism.parameters
    ]
    freed = mechanism.with_parameters(lc.Parameters(tuple(items)))
    freed = freed.with_terms(Term("free", tuple(names), 1e-4))
    noise = lc.Noise(
        {q: float(np.max(sd[np.isfinite(sd)])) for q, sd in result.reading_sds.items()}
    )
    joint = lc.calibrate(freed, result.dataset, noise=noise, method="implicit-loop")
    assert joint.terms[0].scale == pytest.approx(points.scale, rel=0.02)
    for name in result.estimated:
        sd = joint.sd[name]
        assert sd is not None
        assert abs(result.value[name] - joint.value[name]) < 0.05 * sd
    sds = np.array([(result.sd[n], joint.sd[n]) for n in result.estimated], dtype=float)
    np.testing.assert_allclose(sds[:, 0], sds[:, 1], rtol=0.1)
    for name in names:
        assert abs(result.value[name] - joint.value[name]) < 2e-6
    poses = {q: v[:5] for q, v in result.dataset.readings.items() if ":" not in q}
    one, other = (_sds(lc.predict(fit, poses)) for fit in (result, joint))
    # Without the offsets the mean is some 2.0.
    assert (one / other).mean() == pytest.approx(1.0, abs=0.1)
    every = Calibrated.of(result, "").with_offsets.covariance.matrix
    place = result.mechanism.parameters.names
    offsets = np.sqrt([every[place.index(name), place.index(name)] for name in names])
    np.testing.assert_allclose(offsets, [joint.sd[name] or 0.0 for name in names], rtol=0.15)


def test_what_a_file_holds_of_offsets_is_their_covariance(
    scattered: tuple[Shots, FitResult],
) -> None:
    """Given the parameters: the few ways in which all err together, and each point alone."""
    _, result = scattered
    prints, entry = result.prints, result.printed
    assert prints is not None
    assert prints.sums is not None
    assert entry is not None
    names = list(entry.names)
    used = len(result.estimated) + np.array([prints.layout.names.index(n) for n in names])
    H = prints.sums[np.ix_(used, used)] + np.diag(1.0 / np.square(entry.prior))
    offsets = Offsets.of(replace(entry, follow=((),) * len(names)), names, ())
    shares = eigvalsh(offsets.root @ offsets.root.T, np.linalg.inv(H))
    assert 0.9 < shares.min() < shares.max() < 1.1


def test_images_not_used_lie_in_their_regions(
    scattered: tuple[Shots, FitResult], tmp_path: Path
) -> None:
    project = _project(scattered[0], tmp_path)
    made = lc.validate(
        project.mechanism,
        project.dataset,
        noise=project.noise,
        method="implicit-loop",
        folds=4,
    )
    assert made.silent == ()
    assert made.coverage is not None
    assert made.coverage.share >= 0.85


def _later(shots: Shots) -> Shots:
    """Images of another day."""
    rng = np.random.default_rng([91, 4])
    q = poses(shots.rig, IMAGES, rng)
    uv = shots.rig.pixels(shots.rig.flange(q))
    uv = uv + shots.rig.corner * rng.normal(size=uv.shape)
    return Shots(shots.rig, q, q + shots.rig.encoder * rng.normal(size=q.shape), uv)


def test_two_days_of_one_print_agree_in_pixels(
    scattered: tuple[Shots, FitResult], tmp_path: Path
) -> None:
    shots, result = scattered
    compared = lc.compare(result, _calibrated(_later(shots), tmp_path))
    assert compared.differ is False
    assert compared.points is not None
    assert compared.points.inside >= 0.85
    assert compared.points.unit == "px"
    assert compared.points.rms < shots.rig.corner
    assert " px (sd " in compared.verdict()


def test_an_update_is_a_fit_of_all_images_and_carries_the_print_on(
    scattered: tuple[Shots, FitResult], tmp_path: Path
) -> None:
    shots, result = scattered
    project = _project(_later(shots), tmp_path)
    later = project.dataset
    new = lc.update(result, later, moved=False)
    first = result.dataset.readings
    assert {*first} == {*later.readings}
    both = lc.Dataset.from_arrays({q: np.append(first[q], later.readings[q]) for q in first})
    joint = lc.calibrate(
        result.mechanism,
        both,
        noise=project.noise,
        method="implicit-loop",
    )
    for name in joint.estimated:
        sd = joint.sd[name] or np.nan
        # with the points held: 0.08 to 1.0 of it
        assert new.sd[name] == pytest.approx(sd, rel=0.15), name
        assert abs(new.value[name] - joint.value[name]) < 0.3 * sd, name
    names = [n for n in result.mechanism.parameters.of_role("corner") if n in new.estimated]
    assert len(names) >= 2 * COLUMNS * ROWS
    off = np.array([new.value[name] - joint.value[name] for name in names])
    assert np.sqrt(np.square(off).mean()) < 5e-6
    assert [term.name for term in new.terms] == ["points"]


def test_one_point_that_is_elsewhere_is_named_once(tmp_path: Path) -> None:
    off = np.zeros((COLUMNS * ROWS, 3))
    off[17, :2] = 8e-4, -6e-4
    result = _calibrated(_shots(off), tmp_path)
    assert len(lc.find_outliers(result)) == 0
    (points,) = result.terms_with_parts()
    named = [part for part in points.parts if part.words.startswith("the point")]
    assert [part.joints for part in named] == [("17",)]
    # the board as a whole moves with it, by some of one in 48
    assert named[0].size == pytest.approx(1e-3, rel=0.1)


def test_a_column_that_is_off_is_named(tmp_path: Path) -> None:
    off = np.zeros((COLUMNS * ROWS, 3))
    off[np.arange(COLUMNS * ROWS) % COLUMNS == 2, 0] = 5e-4
    result = _calibrated(_shots(off), tmp_path)
    (points,) = result.terms_with_parts()
    assert points.sentences[0].startswith("the column at x = ")


def test_images_of_few_corners_leave_the_corners_their_noise(tmp_path: Path) -> None:
    """No image keeps a row that only its corners' noise acts on."""
    off = np.random.default_rng(7).normal(0.0, 1.5e-4, (COLUMNS * ROWS, 3)) * [1.0, 1.0, 0.0]
    shots = _shots(off)
    uv, rng = shots.uv.copy(), np.random.default_rng(8)
    for image in uv:
        image[rng.choice(len(image), len(image) - 12, replace=False)] = np.nan
    result = _calibrated(replace(shots, uv=uv), tmp_path)
    assert result.learns_terms
    assert "terms" not in vars(result)
    assert [term.name for term in result.terms] == ["points"]
    (sd,) = [entry.sd for entry in result.noise if entry.quantities[0].startswith("cam")]
    assert sd == pytest.approx(shots.rig.corner, rel=0.2)
