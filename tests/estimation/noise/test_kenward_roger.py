"""Kenward and Roger's covariance: against dense matrices, differences and simulated truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from analyses.small_samples import CASES, Drawn, counted
from loopcal.estimation.noise.kenward_roger import learnt_parameters
from loopcal.estimation.noise.linear_model import mixed_fit, projected, whitened
from loopcal.estimation.noise.variance_components import estimate_ratios
from loopcal.measurements.noise import MODEL
from loopcal.mechanisms.model_error import with_model_error

ARM = lc.planar_two_link()
BOX = {"phi2": (0.0, 1.6), "phi3": (0.0, 1.6)}
SDS = {"?P": 5e-4, "phi?": 1e-3}
DRAWS = 60


def learnt(how: dict[str, str], poses: int = 15, prior: lc.Prior | None = None) -> lc.Result:
    at = lc.random_poses(BOX, poses, seed=3)
    readings = lc.simulate(ARM, at, noise=lc.Noise(SDS), seed=4).dataset
    noise = lc.Noise(SDS, estimate=how)
    return lc.calibrate(
        ARM, readings, noise=noise, prior=prior, start="nominal", method="implicit-loop"
    )


def test_slopes_are_differences_of_the_covariance() -> None:
    result = learnt({"?P": "group", "phi?": "each"})
    estimate = result.estimate
    assert estimate is not None
    found = learnt_parameters(estimate)
    for along, error in zip(found.covariance.slopes, found.errors.T, strict=True):
        step = 1e-4 * estimate.sensor_estimate.ratios.min() / np.abs(error).max()
        ends = []
        for side in (-step, step):
            at = projected(estimate.model, estimate.sensor_estimate.ratios + side * error)
            assert at is not None
            ends.append(at.root @ at.root.T)
        np.testing.assert_allclose(
            along, (ends[1] - ends[0]) / (2 * step), rtol=1e-4, atol=1e-6 * np.abs(along).max()
        )


@pytest.mark.parametrize("prior", [None, lc.Prior({"l?": 1e-3})], ids=["flat", "prior"])
def test_the_addition_is_that_of_the_dense_formula(prior: lc.Prior | None) -> None:
    """Phi sum_ij W_ij (Q_ij - P_i Phi P_j) Phi, twice, with all rows and the prior's in one V."""
    result = learnt({"?P": "group", "phi?": "group"}, prior=prior)
    estimate = result.estimate
    assert estimate is not None
    model, ratios = estimate.model, estimate.sensor_estimate.ratios
    rows = sum(block.e.size for block in model.blocks)
    informed = np.flatnonzero(model.precision)
    V = np.zeros((rows + len(informed),) * 2)
    parts = np.zeros((2, *V.shape))
    J = np.zeros((len(V), len(model.precision)))
    at = 0
    for block in model.blocks:
        for i in range(len(block.e)):
            own = slice(at, at + block.e.shape[1])
            J[own], V[own, own] = block.J[i], block.fixed[i]
            for j in (0, 1):
                G = block.G[i][:, block.owner == j]
                parts[j][own, own] = G @ G.T
            at = own.stop
    J[rows + np.arange(len(informed)), informed] = 1.0
    V[rows:, rows:] = np.diag(1.0 / model.precision[informed])
    V += np.tensordot(ratios, parts, 1)
    inverse = np.linalg.inv(V)
    Phi = np.linalg.inv(J.T @ inverse @ J)
    found = learnt_parameters(estimate)
    W = found.errors @ found.errors.T
    total = np.zeros_like(Phi)
    for i in (0, 1):
        for j in (0, 1):
            Q = J.T @ inverse @ parts[i] @ inverse @ parts[j] @ inverse @ J
            P_i, P_j = (-J.T @ inverse @ parts[k] @ inverse @ J for k in (i, j))
            total += W[i, j] * (Q - P_i @ Phi @ P_j)
    np.testing.assert_allclose(found.covariance.plain, Phi, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(
        found.covariance.matrix, Phi + 2 * Phi @ total @ Phi, rtol=1e-4, atol=1e-12
    )


def test_sums_and_poses_say_the_same_under_one_factor() -> None:
    """With terms and one factor of all noise the sums of the fit give what all its rows give."""
    machine = ARM.with_parameters(ARM.parameters.with_prior({"l?": 1e-3}))
    machine = machine.with_terms(lc.Term("lengths", ("l2", "l3"), 1e-3))
    at = lc.random_poses(BOX, 15, seed=3)
    readings = lc.simulate(ARM, at, noise=lc.Noise(SDS), seed=4).dataset
    noise = lc.Noise(SDS, estimate={"*": "group"})
    result = lc.calibrate(machine, readings, noise=noise, method="implicit-loop")
    estimate = result.estimate
    assert estimate is not None
    variances = estimate.variances
    assert variances.sensors is None
    sensors = estimate_ratios(estimate.model, variances.ratios)
    rows = replace(estimate, variances=replace(variances, sensors=sensors))
    by_sums, by_rows = learnt_parameters(estimate), learnt_parameters(rows)
    size = np.sqrt(np.diag(by_rows.matrix))
    off = (by_sums.matrix - by_rows.matrix) / np.outer(size, size)
    assert np.abs(off).max() < 2e-3  # the last round still moves the ratio by so much
    np.testing.assert_allclose(
        by_sums.covariance.freedom, by_rows.covariance.freedom, rtol=5e-3, atol=0.0
    )


def test_one_factor_of_all_noise_has_the_degrees_of_the_residuals() -> None:
    result = learnt({"*": "group"})
    np.testing.assert_allclose(result.learnt_covariance.matrix, result.learnt_covariance.plain)
    freedom = result.degrees_of_freedom["l2"]
    assert freedom == pytest.approx(2 * 15 - 6, rel=0.05)


def test_least_squares_has_the_degrees_of_its_residuals() -> None:
    at = lc.random_poses(BOX, 9, seed=3)
    readings = lc.simulate(ARM, at, noise=lc.Noise(SDS), seed=4).dataset
    result = lc.calibrate(ARM, readings, method="least-squares", start="nominal")
    assert result.degrees_of_freedom["l2"] == pytest.approx(2 * 9 - 6)


def test_terms_leave_the_lengths_unsure() -> None:
    """The scale of a term learnt from two lengths has few degrees of freedom, so have these."""
    machine = ARM.with_parameters(ARM.parameters.with_prior({"l?": 1e-3}))
    machine = machine.with_terms(lc.Term("lengths", ("l2", "l3"), 1e-3))
    at = lc.random_poses({"phi2": (0.0, 0.3), "phi3": (0.5, 0.8)}, 15, seed=3)
    readings = lc.simulate(ARM, at, noise=lc.Noise(SDS), seed=4).dataset
    result = lc.calibrate(
        machine, readings, noise=lc.Noise(SDS), start="nominal", method="implicit-loop"
    )
    freedom = result.degrees_of_freedom["l2"]
    assert freedom is not None
    assert freedom < 30.0
    assert result.sd["l2"] > np.sqrt(np.diag(result.learnt_covariance.plain))[2]


@pytest.mark.parametrize(("case", "poses"), [(CASES[0], 12), (CASES[2], 8)], ids=str)
def test_intervals_regions_and_comparisons_hold_at_few_poses(case: object, poses: int) -> None:
    """`analyses/small_samples.py` does the same at full size."""
    found: list[Drawn] = counted(case, poses, range(DRAWS))  # type: ignore[arg-type]
    student, points = (
        np.array([getattr(d, name) for d in found]) for name in ("student", "points")
    )
    for inside in (student, points):
        assert inside.mean() > 0.95 - 3 * inside.std(ddof=1) / np.sqrt(len(found))
    alarms = np.mean([d.p_value < 0.05 for d in found])
    assert alarms < 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(found))
    # as if the learnt sds were known: the fault that this mends
    assert np.mean([d.normal for d in found]) < student.mean()
    assert np.mean([d.p_known < 0.05 for d in found]) > alarms


def test_a_worse_instrument_is_not_called_a_fault_of_the_model() -> None:
    """An isotropic error of the model and a tracker five times worse look alike: both are named."""
    at = lc.random_poses(BOX, 60, seed=3)
    really = lc.Noise({"?P": 5e-4, "phi?": 1e-4})
    readings = lc.simulate(ARM, at, noise=really, seed=4).dataset
    stated = lc.Noise({"?P": 1e-4, "phi?": 1e-4, "model": 1e-4}, estimate={"model": "group"})
    result = lc.calibrate(ARM, readings, noise=stated, start="nominal", method="implicit-loop")
    said = [warning for warning in result.warnings if "limits the accuracy" in warning]
    assert len(said) == 1
    assert "instrument" in said[0]
    assert "Repeat readings" in said[0]


def test_the_score_alone_is_that_beside_the_information() -> None:
    estimate = learnt({"?P": "group", "phi?": "each"}).estimate
    assert estimate is not None
    joined = whitened(estimate.model, estimate.sensor_estimate.ratios)
    assert joined is not None
    beside = mixed_fit(estimate.model, joined)
    alone = mixed_fit(estimate.model, joined, beside.information)
    assert alone.criterion == beside.criterion
    size = np.sqrt(np.diag(beside.information))
    np.testing.assert_allclose(alone.score / size, beside.score / size, atol=1e-9)


def test_no_variance_is_unsure_by_more_than_itself() -> None:
    """Instrument and model noise of the same readings: only their sum is seen."""
    machine = with_model_error(ARM)
    at = lc.random_poses(BOX, 12, seed=3)
    readings = lc.simulate(ARM, at, noise=lc.Noise(SDS), seed=4).dataset
    noise = lc.Noise(SDS | {MODEL: 5e-4}, estimate={"?P": "group", MODEL: "group"})
    result = lc.calibrate(machine, readings, noise=noise, start="nominal", method="implicit-loop")
    estimate = result.estimate
    assert estimate is not None
    found, ratios = learnt_parameters(estimate), estimate.sensor_estimate.ratios
    shares = np.abs(found.errors[ratios > 0.0] / ratios[ratios > 0.0, None])
    assert shares.max() == pytest.approx(1.0)
    assert lc.predict(result, at).freedom.min() > 1.5
