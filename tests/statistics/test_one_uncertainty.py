"""`predict`, the answer "valid" and what `verify` expects state one uncertainty of a pose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.result.result_file import read_result, write_result
from loopcal.statistics.predictor import predictor, predictor_of
from loopcal.statistics.region import region_of

OUTPUT, JOINT = 1e-4, 2e-4
NOISE = lc.Noise({"?P": OUTPUT, "phi?": JOINT})
POSE = {"phi2": 0.4, "phi3": 1.1}
METHODS = ("auto", "implicit-loop", "reweighted", "least-squares")


def two_link(x: Any, p: Any) -> tuple[Any, Any]:
    a = x.phi2 + p.phi20
    b = a + x.phi3 + p.phi30
    return (
        p.xA + p.l2 * np.cos(a) + p.l3 * np.cos(b) - x.xP,
        p.yA + p.l2 * np.sin(a) + p.l3 * np.sin(b) - x.yP,
    )


# No instrument that `verify` could place anew: its errors are those of the very pose.
ARM = lc.Mechanism.from_function(
    two_link,
    quantities={"xP": "m", "yP": "m", "phi2": "rad", "phi3": "rad"},
    parameters={
        "xA": (0.0, "m"),
        "yA": (0.0, "m"),
        "l2": (0.8, "m"),
        "l3": (0.6, "m"),
        "phi20": (0.0, "rad"),
        "phi30": (0.0, "rad"),
    },
    outputs=("xP", "yP"),
)
JOINTS = lc.random_poses({"phi2": (-2.0, 2.0), "phi3": (-2.0, 2.0)}, 12, seed=1)


def calibrated(method: str, stated: float = 1.0) -> lc.Result:
    """stated: factor of the sds that are stated."""
    made = lc.simulate(ARM, JOINTS, noise=NOISE, seed=1, truth={"l2": 0.803})
    sds = {"?P": stated * OUTPUT, "phi?": stated * JOINT}
    noise = None if method == "least-squares" else lc.Noise(sds)
    return lc.calibrate(ARM, made.dataset, noise=noise, method=method)


def predicted(result: lc.Result) -> float:
    made = lc.predict(result, {q: [v] for q, v in POSE.items()})
    return float(np.sqrt(np.trace(made.covariance[0])))


def valid(result: lc.Result) -> float:
    """Over a working region that is this pose."""
    known = predictor(result)
    assert known is not None
    region = region_of(result, known, {q: (v, v + 1e-9) for q, v in POSE.items()})
    assert region is not None
    assert region.worst.sd is not None
    return region.worst.sd


@pytest.mark.parametrize("method", METHODS)
def test_predict_valid_and_expected_are_one(method: str, tmp_path: Path) -> None:
    result = calibrated(method)
    total = predicted(result)
    assert valid(result) == pytest.approx(total, rel=1e-6)
    # So many readings near this pose, to a sixteenth of the sd, are those of this pose.
    near = {q: np.linspace(v - 1e-5, v + 1e-5, 40) for q, v in POSE.items()}
    day = lc.simulate(ARM, near, noise=NOISE, seed=5).dataset
    expected = lc.verify(result, day).expected
    assert expected is not None
    # Compared with what an instrument reads, whose noise residuals hold already.
    read = 0.0 if method == "least-squares" else np.sqrt(2.0) * OUTPUT
    assert expected.rms == pytest.approx(np.hypot(total, read), rel=0.06)
    known = predictor(result)
    assert known is not None
    write_result(result, replace(result.document, prediction=known.entry), tmp_path)
    by_files = predictor_of(read_result(tmp_path / "result.json"), ARM)
    made = lc.predict(by_files, {q: [v] for q, v in POSE.items()})  # as the command line does
    assert np.sqrt(np.trace(made.covariance[0])) == pytest.approx(total, rel=1e-9)


def test_sds_that_chi_squared_rejects_are_as_large_as_the_residuals(tmp_path: Path) -> None:
    result = calibrated("implicit-loop", stated=0.2)
    chi = result.chi_squared
    assert chi is not None
    assert chi.variance_factor is not None
    right = predicted(calibrated("implicit-loop"))
    assert predicted(result) == pytest.approx(np.sqrt(chi.variance_factor) * 0.2 * right, rel=0.01)
    assert valid(result) == pytest.approx(predicted(result), rel=1e-6)


def test_after_least_squares_regions_hold_the_true_point() -> None:
    """Joints err anew with each pose, and the residuals say by how much."""
    held, sizes = [], []
    at = lc.random_poses({"phi2": (-2.0, 2.0), "phi3": (-2.0, 2.0)}, 20, seed=3)
    true = lc.simulate(ARM, at, noise=lc.Noise({"*": 0.0}), seed=0).quantities
    for seed in range(100):
        made = lc.simulate(ARM, JOINTS, noise=NOISE, seed=seed).dataset
        result = lc.calibrate(ARM, made, method="least-squares")
        rng = np.random.default_rng([5, seed])
        read = {q: v + JOINT * rng.standard_normal(len(v)) for q, v in at.items()}
        here = lc.predict(result, read)
        off = np.array([here.outputs[q] - true[q] for q in ("xP", "yP")]).T
        square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(here.covariance), off)
        held.append(float((square <= here.region()).mean()))
        stated = np.einsum("nii->n", here.covariance).mean()
        sizes.append(float(np.sqrt(np.square(off).sum(axis=1).mean() / stated)))
    # The noise of the instrument, a fifth of the variance here, is in the residuals too.
    assert 0.93 < np.mean(held) < 0.99
    assert 0.8 < np.mean(sizes) < 1.1


def test_range_and_angles_are_valid_by_the_place_of_their_point() -> None:
    arm = lc.assemble(
        lc.machines.planar_two_link(),
        [lc.instruments.spherical(dimension=2)],
        {"tracker_x": 4.0, "tracker_y": 1.0},
    )
    angles = [q for q, unit in arm.quantities.items() if unit == "rad"]
    joints, azimuth = [q for q in angles if q in arm.joints], arm.outputs[1]
    noise = lc.Noise({arm.outputs[0]: 2e-5, **dict.fromkeys(angles, JOINT), azimuth: 1e-4})
    made = lc.simulate(
        arm, lc.random_poses(dict.fromkeys(joints, (-1.5, 1.5)), 30, seed=1), noise=noise, seed=1
    )
    result = lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")
    pose = dict(zip(joints, (0.4, 1.1), strict=True))
    at = lc.predict(result, {q: [v] for q, v in pose.items()})
    distance = at.outputs[arm.outputs[0]][0]
    lever = np.diag([1.0, distance])  # [m] of the point per m and per rad
    known = predictor(result)
    assert known is not None
    region = region_of(result, known, {q: (v, v + 1e-9) for q, v in pose.items()})
    assert region is not None
    assert [one.unit for one in region.by] == ["m"]
    sd = np.sqrt(np.trace(lever @ at.covariance[0] @ lever))
    assert region.worst.sd == pytest.approx(sd, rel=1e-6)
