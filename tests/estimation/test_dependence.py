"""Residuals that depend on each other: error rates of the tests, a covariance under drift."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.machines import LINEAR_DELTA
from loopcal.chi_squared import quantile
from loopcal.estimation.dependence import serial
from loopcal.estimation.dependence.dependence import in_order, likeness, near
from loopcal.estimation.dependence.seen import Seen, instruments
from loopcal.estimation.dependence.serial import Drift, Whole, _criterion, learnt_drift
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.execution.forked import Forked
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.parallel.delta import linear_delta

Array = NDArray[np.float64]
SDS = {"phi2": 1e-4, "phi3": 1e-4, "xP": 1e-4, "yP": 1e-4}
ARM = lc.planar_two_link()
TRUTH = {p.name: p.nominal for p in ARM.parameters}


def path(poses: int, rng: np.random.Generator) -> dict[str, Array]:
    """Joint angles [rad] along a smooth path."""
    t = np.linspace(0.0, 2 * np.pi, poses)
    return {
        q: sum(
            rng.normal(0.0, 0.8 / np.sqrt(m)) * np.sin(m * t + rng.uniform(0.0, 2 * np.pi))
            for m in (1, 2, 3, 5)
        )
        for q in ("phi2", "phi3")
    }


def anywhere(poses: int, rng: np.random.Generator) -> dict[str, Array]:
    return {q: rng.uniform(-np.pi, np.pi, poses) for q in ("phi2", "phi3")}


def points(joints: dict[str, Array], values: dict[str, float]) -> Array:
    """x, y (2, N) of the arm, written out by hand."""
    p = values
    along = joints["phi2"] + p["phi20"]
    beyond = along + joints["phi3"] + p["phi30"]
    x = p["xA"] + p["l2"] * np.cos(along) + p["l3"] * np.cos(beyond)
    y = p["yA"] + p["l2"] * np.sin(along) + p["l3"] * np.sin(beyond)
    return np.array([x, y])


def forgetting(rho: float, poses: int, rng: np.random.Generator) -> Array:
    """(2, N) errors of variance 1 whose correlation falls by rho from pose to pose."""
    u = rng.standard_normal((2, poses))
    for i in range(1, poses):
        u[:, i] = rho * u[:, i - 1] + np.sqrt(1.0 - rho**2) * u[:, i]
    return u


def calibrated(
    joints: dict[str, Array], errors: Array, rng: np.random.Generator, **noise: Any
) -> FitResult:
    read = {q: v + rng.normal(0.0, SDS[q], len(v)) for q, v in joints.items()}
    measured = points(joints, TRUTH) + errors
    data = lc.Dataset.from_arrays(read | dict(zip(("xP", "yP"), measured, strict=True)))
    told = lc.Noise(SDS, **noise)
    return lc.calibrate(ARM, data, noise=told, start="nominal", method="implicit-loop")


def white(poses: int, rng: np.random.Generator) -> Array:
    return rng.normal(0.0, SDS["xP"], (2, poses))


@pytest.mark.parametrize("measured", [anywhere, path])
def test_independent_errors_are_rejected_as_often_as_the_level_says(measured) -> None:
    serial, spatial = [], []
    for seed in range(200):
        rng = np.random.default_rng([1, seed])
        found = calibrated(measured(50, rng), white(50, rng), rng).dependence
        assert found is not None
        (one,) = found.instruments
        assert one.serial is not None
        assert one.spatial is not None
        serial.append(one.serial.p_value)
        spatial.append(one.spatial.p_value)
    for p in (np.array(serial), np.array(spatial)):
        assert np.mean(p < 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 200)
        assert np.mean(p < 0.01) <= 0.01 + 3 * np.sqrt(0.01 * 0.99 / 200)
        assert 0.35 < np.mean(p) < 0.65


@pytest.mark.parametrize("rho", [0.6, 0.95])
def test_under_a_drift_the_regions_of_predicted_points_hold(rho: float) -> None:
    held, plain = [], []
    for seed in range(40):
        rng = np.random.default_rng([2, seed])
        joints = path(100, rng)
        result = calibrated(joints, 3e-4 * forgetting(rho, 100, rng), rng)
        assert result.dependence is not None
        assert result.dependence.serial
        assert any("depend on the pose order" in w for w in result.warnings)
        near_the_path = {q: v[::10] + rng.normal(0.0, 0.05, 10) for q, v in joints.items()}
        held.append(_held(result, near_the_path, result.covariance))
        plain.append(_held(result, near_the_path, result.spectrum.covariance()))
    assert np.mean(held) >= 0.90
    assert np.mean(plain) <= (0.10 if rho > 0.9 else 0.40)


def _held(result: FitResult, joints: dict[str, Array], covariance: Array) -> float:
    """Share of points whose joint 95 % region holds the truth."""
    mechanism, none = result.mechanism, np.zeros((0, 10))
    x = np.array([joints.get(q, np.zeros(10)) for q in mechanism.quantities])
    p = np.array([result.value[n] for n in mechanism.parameters.names])
    away = predict_outputs(mechanism, p, x, none) - points(joints, TRUTH)
    x[[mechanism.tape.quantities.index(q) for q in mechanism.outputs]] += points(joints, TRUTH)
    S = output_sensitivity(mechanism, p, result.estimated, x, none).by_parameter
    V = S @ covariance @ S.transpose(0, 2, 1)
    square = np.einsum("on,no->n", away, np.linalg.solve(V, away.T[:, :, None])[:, :, 0])
    return float(np.mean(square <= quantile(0.05, 2)))


def test_an_arm_that_bends_is_seen_in_joint_space_and_not_in_a_random_order() -> None:
    serial = spatial = 0
    for seed in range(40):
        rng = np.random.default_rng([3, seed])
        joints = anywhere(120, rng)
        beyond = joints["phi2"] + joints["phi3"]
        sag = np.array([np.zeros(120), -1e-3 * (1.0 + np.cos(beyond) * np.cos(beyond))])
        found = calibrated(joints, sag + white(120, rng), rng).dependence
        assert found is not None
        serial, spatial = serial + bool(found.serial), spatial + bool(found.spatial)
    assert spatial >= 32
    assert serial <= 2


def test_a_clean_result_keeps_its_covariance_and_does_not_warn() -> None:
    rng = np.random.default_rng(4)
    result = calibrated(anywhere(60, rng), white(60, rng), rng)
    assert result.dependence is not None
    assert not result.dependence.warnings()
    assert np.array_equal(result.covariance, result.spectrum.covariance())
    assert fit_document(result).dependence == result.dependence


def test_a_robust_loss_is_not_tested() -> None:
    rng = np.random.default_rng(5)
    joints = anywhere(60, rng)
    data = lc.Dataset.from_arrays(
        joints | dict(zip(("xP", "yP"), points(joints, TRUTH) + white(60, rng), strict=True))
    )
    result = lc.calibrate(
        ARM, data, noise=lc.Noise(SDS), loss="huber", start="nominal", method="implicit-loop"
    )
    assert result.dependence is None


def whole_system(rng: np.random.Generator, N: int = 14, q: int = 2, k: int = 3) -> tuple:
    """Equations with D^T D + P = I, their D (Nq, k), E and P."""
    D = rng.standard_normal((N * q, k))
    P = np.diag([0.0, 0.5, 2.0])
    root = np.linalg.inv(np.linalg.cholesky(D.T @ D + P).T)
    D, P = D @ root, root.T @ P @ root
    E = rng.standard_normal(N * q)
    E -= D @ (D.T @ E)
    whole = Whole(D.T @ D, D.T @ E, float(E @ E), P, np.zeros(k), 0.0, N * q)
    X = rng.standard_normal((N, q, q))
    turned = X.transpose(0, 2, 1)
    E_pose, D_pose = E.reshape(N, q, 1), D.reshape(N, q, k)
    seen = Seen((turned @ E_pose)[:, :, 0], turned @ D_pose, turned @ X)
    return whole, seen, D, E, P, X


def test_the_moments_of_the_statistic_are_those_of_the_projected_quadratic_form() -> None:
    rng = np.random.default_rng(6)
    whole, seen, D, E, P, X = whole_system(rng)
    N, q = seen.y.shape
    K = np.zeros((N * q, N * q))
    for i, j in in_order(seen).T:
        K[i * q : (i + 1) * q, j * q : (j + 1) * q] += 0.5 * X[i] @ X[j].T
        K[j * q : (j + 1) * q, i * q : (i + 1) * q] += 0.5 * X[j] @ X[i].T
    G = np.vstack([D, np.linalg.cholesky(P + 1e-14 * np.eye(3)).T])
    K = np.pad(K, ((0, 3), (0, 3)))
    M = np.eye(len(G)) - G @ G.T
    freedom = round(float(np.trace(M)))
    A = M @ K @ M
    mean = np.trace(A) / freedom
    variance = 2 * (freedom * np.trace(A @ A) - np.trace(A) ** 2) / freedom**2 / (freedom + 2)
    products = [seen.y[i] @ seen.y[j] for i, j in in_order(seen).T]
    variance = max(variance, np.square(products).sum() / whole.EE**2)
    deviate = (E @ K[:-3, :-3] @ E / whole.EE - mean) / np.sqrt(variance)
    from scipy.stats import norm

    found = likeness(seen, in_order(seen), whole.EE, freedom)
    assert found is not None
    assert found.p_value == pytest.approx(norm.sf(deviate), rel=1e-6)


def test_the_banded_likelihood_is_that_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(7)
    whole, seen, D, E, P, X = whole_system(rng)
    N, q = seen.y.shape
    columns = np.concatenate([seen.A, seen.y[:, :, None]], axis=2)
    values = []
    for rho, ratio in ((0.5, 2.0), (0.9, 0.3), (0.0, 1e-9)):
        found, s2 = _criterion((whole, seen.M, columns), (rho, ratio))
        R = rho ** np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
        V = np.eye(N * q)
        for i in range(N):
            for j in range(N):
                rows = slice(i * q, (i + 1) * q), slice(j * q, (j + 1) * q)
                V[rows] += ratio * R[i, j] * X[i] @ X[j].T
        V *= s2
        H = D.T @ np.linalg.solve(V, D) + P
        g = D.T @ np.linalg.solve(V, E)
        square = E @ np.linalg.solve(V, E) - g @ np.linalg.solve(H, g)
        dense = np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1] + square
        values.append((found, dense))
    differences = np.diff(np.array(values), axis=0)
    assert differences[:, 0] == pytest.approx(differences[:, 1], rel=1e-6)


def test_the_covariance_under_a_drift_is_never_without_the_noise() -> None:
    whole, seen, *_ = whole_system(np.random.default_rng(8))
    drift = learnt_drift(whole, seen)
    assert np.linalg.eigvalsh(drift.covariance(whole, seen)).min() > 0.0
    assert 0.0 < drift.share < 1.0
    assert drift.length > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_points_of_the_grid_that_are_not_sought_weigh_nothing(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    whole, seen, D, E, _, X = whole_system(rng, N=150)
    u = forgetting(0.9, 150, rng).T
    E = E + np.einsum("nij,nj->ni", X, u).ravel()
    whole = replace(whole, DE=D.T @ E, EE=float(E @ E))
    seen = Seen(np.einsum("nij,ni->nj", X, E.reshape(150, 2)), seen.A, seen.M)
    counts: list[Any] = []
    criterion = serial._criterion

    def counted(*given: Any) -> tuple[float, float]:
        counts.append(given[-1])
        return criterion(*given)

    monkeypatch.setattr(serial, "_criterion", counted)
    drift = learnt_drift(whole, seen)
    monkeypatch.setattr(serial, "_FAR", np.inf)
    sought = len(counts)
    everywhere = learnt_drift(whole, seen)
    assert sought < 80
    assert len(counts) - sought == 100
    assert drift.covariance(whole, seen) == pytest.approx(
        everywhere.covariance(whole, seen), rel=1e-3
    )


def test_a_drift_is_the_same_whoever_evaluates_its_likelihood(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, seen, *_ = whole_system(np.random.default_rng(9))
    alone = learnt_drift(whole, seen)
    monkeypatch.setattr(serial, "_LONG", 0)
    monkeypatch.setattr(serial, "process_cores", lambda: Forked(2))
    shared = learnt_drift(whole, seen)
    assert (shared.white, shared.share, shared.length) == (alone.white, alone.share, alone.length)
    assert np.array_equal(shared.sizes, alone.sizes)


def test_what_was_computed_of_a_fit_stays_with_further_parts_beside_it() -> None:
    rng = np.random.default_rng(11)
    result = calibrated(path(60, rng), 3e-4 * forgetting(0.95, 60, rng), rng)
    drifting = result.drifting
    assert drifting is not None
    noted = result.noted("a note")
    assert noted.drifting is drifting
    assert lc.Result.of(noted, title="a title").drifting is drifting
    assert noted.warnings == (*result.warnings, "a note")
    assert result.as_if_independent().drifting is None


def test_the_covariance_under_a_drift_is_the_sandwich_of_its_whole_matrix() -> None:
    whole, seen, D, _, P, X = whole_system(np.random.default_rng(10))
    N, q = seen.y.shape
    drift = Drift(1.3, np.array([2.0, 30.0]), np.array([0.4, 2.0]), 0.5, 5.0)
    apart = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    V = 1.3 * np.eye(N * q)
    for length, size in ((2.0, 0.4), (30.0, 2.0)):
        R = np.exp(-apart / length)
        for i in range(N):
            for j in range(N):
                rows = slice(i * q, (i + 1) * q), slice(j * q, (j + 1) * q)
                V[rows] += size * R[i, j] * X[i] @ X[j].T
    assert drift.covariance(whole, seen) == pytest.approx(D.T @ V @ D + P, rel=1e-9)


def test_a_drift_that_is_known_gives_the_covariance_of_the_fit_it_was_learnt_from() -> None:
    rng = np.random.default_rng(11)
    result = calibrated(path(60, rng), 3e-4 * forgetting(0.95, 60, rng), rng)
    assert result.drifting is not None
    every = np.eye(len(result.estimated))
    under, alone = (result.covariance_through(every, d).matrix for d in (result.drifting, None))
    assert under == pytest.approx(result.covariance, rel=1e-9)
    assert (np.diag(alone) < np.diag(result.covariance)).all()


def test_a_drift_beside_learnt_sds_predicts() -> None:
    rng = np.random.default_rng(11)
    errors = 3e-4 * forgetting(0.95, 60, rng)
    result = calibrated(path(60, rng), errors, rng, estimate={("xP", "yP"): "group"})
    assert result.drifting is not None
    predicted = lc.predict(result, path(10, rng))
    assert np.isfinite(predicted.covariance).all()
    assert np.isinf(predicted.denominator).all()


def test_neighbours_in_joint_space_are_apart_in_order() -> None:
    points = np.random.default_rng(9).uniform(size=(40, 2))
    i, j = near(points, neighbours=3, apart=4)
    assert len(i) > 40
    assert (np.abs(i - j) > 4).all()
    assert near(points[:5], apart=3).shape == (2, 0)


def test_pairs_that_an_instrument_did_not_read_do_not_dilute_a_correlation() -> None:
    rng = np.random.default_rng(4)
    y = np.repeat(rng.standard_normal((30, 1)), 2, axis=0)  # neighbours are equal
    whole = Seen(y, np.zeros((60, 1, 0)), np.ones((60, 1, 1)))
    half = Seen(y.copy(), whole.A, whole.M.copy())
    half.y[30:], half.M[30:] = 0.0, 0.0
    pairs = np.array([np.arange(0, 60, 2), np.arange(1, 60, 2)])
    for seen in (whole, half):
        found = likeness(seen, pairs, float(np.square(seen.y).sum()), int(seen.read.sum()))
        assert found is not None
        assert found.correlation == pytest.approx(1.0)


def test_residuals_that_are_rounding_are_not_tested() -> None:
    """Readings without noise: what is left is how numbers are rounded, and no drift."""
    arm = lc.planar_two_link()
    poses = lc.grid_poses({"phi2": (0.0, 1.5, 12), "phi3": (0.2, 1.5, 12)})
    exact = lc.simulate(arm, poses, noise={"phi?": 0.0, "?P": 0.0}, seed=1)
    sds = {"phi?": 1e-3, "?P": 1e-4}
    result = lc.calibrate(arm, exact.dataset, noise=sds, method="implicit-loop")
    assert result.chi_squared is not None
    assert result.chi_squared.value < 1e-12
    tested = result.dependence.instruments if result.dependence is not None else ()
    assert all(one.serial is None and one.spatial is None for one in tested)


def test_a_station_from_which_nothing_was_measured_is_no_instrument_of_the_day() -> None:
    """On a later day only one of two trackers may be there."""
    stations = [
        point(f"p{i}", readings=tuple(f"{axis}{i}" for axis in "xyz"), station=f"s{i}", target="t")
        for i in (1, 2)
    ]
    mechanism = lc.assemble(linear_delta(), stations)
    driven = lc.random_poses(LINEAR_DELTA, 30, seed=1)
    noise = lc.Noise({"slide_*": 1e-5, "[xyz]?": 2e-5, "platform_*": math.inf})
    data = lc.simulate(mechanism, driven, noise=noise, seed=2).dataset
    alone = {name: np.nan * v if name[1:] == "2" else v for name, v in data.readings.items()}
    for readings, names in ((data.readings, ["p1", "p2"]), (alone, ["p1"])):
        made = lc.calibrate(mechanism, lc.Dataset(readings), noise=noise, method="implicit-loop")
        assert [family.name for family in instruments(made.problem)] == names
