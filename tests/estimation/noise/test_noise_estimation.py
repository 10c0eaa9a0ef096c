"""The sds of sensors are learnt: right on average, with the uncertainty they state, zero if so."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

import loopcal as lc
from analyses.variance_components import SMALL, SmallNoise
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.noise import estimation
from loopcal.estimation.noise.estimation import _mixed, estimate_noise
from loopcal.estimation.noise.learning import components
from loopcal.estimation.noise.linear_model import LinearModel, ModelBlock, linear_model, whitened
from loopcal.estimation.noise.linear_model import fit as mixed_fit
from loopcal.estimation.noise.variance_bounds import upper_bound, without_component
from loopcal.estimation.noise.variance_components import (
    Estimate,
    estimate_ratios,
)
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import solve
from loopcal.execution.forked import Forked
from loopcal.mechanisms.model_error import with_model_error
from tests.refusals import refused

WITH_MODEL = {"?P": "group", "phi?": "group", "model": "group"}


def planar_poses() -> dict[str, np.ndarray[Any, Any]]:
    turns = np.radians(np.arange(0, 100, 10.0))
    phi2, phi3 = np.meshgrid(turns, turns)
    return {"phi2": phi2.ravel(), "phi3": phi3.ravel()}


def learnt(result: FitResult) -> dict[str, tuple[float, float | None]]:
    return {entry.quantities[0]: (entry.sd, entry.sd_of_sd) for entry in result.noise}


@pytest.mark.parametrize("spreads", [(), (0.5, math.inf, 2.0)], ids=["flat", "known in part"])
def test_the_criterion_s_slope_is_its_score(spreads: tuple[float, ...]) -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-3})
    data = lc.simulate(arm, poses, noise=noise, seed=1).dataset
    result = calibrate(arm, data, noise=noise)
    corrections = np.array(list(result.corrections.values()))
    parameters = np.array(list(result.value.values()))
    problem = build_problem(arm, data, noise)
    model = linear_model(problem, parameters, corrections, [[0, 1], [2], [3]], spreads)
    at = np.array([1.3, 0.7, 1.1])
    found = mixed_fit(model, at)
    assert found is not None
    for j in range(3):
        step = 1e-5 * np.eye(3)[j]
        up, down = mixed_fit(model, at + step), mixed_fit(model, at - step)
        assert up is not None
        assert down is not None
        slope = (up.criterion - down.criterion) / 2e-5
        assert slope == pytest.approx(-2 * found.score[j], rel=1e-5, abs=1e-5)


def test_the_sums_of_a_fit_are_those_of_its_linear_model() -> None:
    """So a round of learning takes them as they are, and adds up no pose again."""
    arm, poses = lc.planar_two_link(), planar_poses()
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-3})
    problem = build_problem(arm, lc.simulate(arm, poses, noise=noise, seed=4).dataset, noise)
    end = solve(problem)
    model = linear_model(problem, end.parameters, end.corrections, [[0, 1], [2], [3]])
    joined = whitened(model, np.ones(3))
    assert joined is not None
    length = np.sqrt(np.diag(joined.total))
    apart = (end.data.products - joined.total) / np.outer(length, length)
    assert np.abs(apart).max() < 1e-9


def test_parameters_that_are_hardly_told_apart_cost_the_criterion_no_digits() -> None:
    """J A dp' describes the same poses as J dp: the criterion changes by 2 log |det A| at most."""
    rng = np.random.default_rng(2)
    e, J = rng.normal(size=(100, 3)), rng.normal(size=(100, 3, 8))
    sizes = rng.uniform(1, 2, (100, 4)) ** 0.5
    G, owner = np.eye(3)[:, [0, 1, 1, 2]] * sizes[:, None, :], np.array([0, 0, 1, 1])
    A = np.eye(8)
    A[0, 1], A[1, 1] = 1.0, 1e-6
    at = np.array([1.0, 1.0])
    flat, none = np.zeros(8), np.zeros((100, 3, 3))
    changes = []
    for ratios in (at, 1.1 * at):
        found = [
            mixed_fit(
                LinearModel(
                    (ModelBlock(np.concatenate([D, e[:, :, None]], axis=2), none, G, owner),),
                    flat,
                    flat,
                    np.full(2, np.inf),
                ),
                ratios,
            )
            for D in (J, J @ A)
        ]
        assert found[0] is not None
        assert found[1] is not None
        changes.append(found[1].criterion - found[0].criterion)
    assert changes[0] == pytest.approx(2 * math.log(1e-6), abs=1e-7)
    assert changes[1] == pytest.approx(changes[0], abs=1e-8)


@pytest.mark.parametrize("method", ["implicit-loop", "reweighted"])
def test_joint_and_tracker_sds_from_far_off_starts(method: str) -> None:
    arm = lc.motoman_ma1400()
    rng = np.random.default_rng(0)
    start = lc.Noise({"theta_*": 1e-4, "xyz": 1e-5}, estimate={"theta_*": "group", "xyz": "group"})
    joints, trackers = [], []
    for draw in range(25):
        q = {f"theta_{i}": rng.uniform(-1.5, 1.5, 200) for i in range(1, 7)}
        truth = lc.Noise({"theta_*": 4e-5, "xyz": 3e-5})
        data = lc.simulate(arm, q, noise=truth, seed=draw).dataset
        found = learnt(calibrate(arm, data, noise=start, method=method))
        joints.append(found["theta_1"])
        trackers.append(found["x"])
    for sds, true in ((joints, 4e-5), (trackers, 3e-5)):
        values = np.array([sd for sd, _ in sds])
        stated = float(np.median([s for _, s in sds if s is not None]))
        assert values.mean() == pytest.approx(true, abs=4 * stated / math.sqrt(len(values)))
        assert values.std(ddof=1) == pytest.approx(stated, rel=4 / math.sqrt(2 * len(values)))


@pytest.mark.parametrize("bad", ["phi2", "phi3"])
def test_an_encoder_a_hundred_times_worse_than_said_is_found_out(bad: str) -> None:
    """Tables 5 and 7 of the seed, with equal sds assumed; one file is searched for faults too."""
    arm, poses = lc.planar_two_link(), planar_poses()
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3} | {bad: 0.1}
    equal = lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"})
    known, guessed = [], []
    for draw in range(8):
        data = lc.simulate(arm, poses, noise=lc.Noise(sds), seed=draw).dataset
        trusted = draw > 0
        stated = calibrate(arm, data, noise=lc.Noise(sds), trusted=trusted)
        known.append(list(stated.value.values()))
        result = calibrate(arm, data, noise=equal, trusted=trusted)
        guessed.append(list(result.value.values()))
        assert learnt(result)[bad][0] == pytest.approx(0.1, rel=0.35)
    true = [parameter.nominal for parameter in arm.parameters]
    rms = [np.sqrt(np.square(np.array(v) - true).mean(axis=0)) for v in (known, guessed)]
    assert np.all(rms[1] <= 1.1 * rms[0])


def test_noise_that_is_not_there_ends_at_zero_below_a_bound() -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    truth = lc.Noise({"?P": 1e-4, "phi2": 1e-3, "phi3": 0.0})
    start = lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"})
    ended, below = 0, 0
    for draw in range(20):
        data = lc.simulate(arm, poses, noise=truth, seed=draw).dataset
        result = calibrate(arm, data, noise=start)
        entry = next(e for e in result.noise if e.quantities == ("phi3",))
        if entry.sd == 0.0:
            ended += 1
            assert any("not detectable" in w for w in result.warnings)
        assert entry.upper is not None or entry.p_value is not None
        below += entry.sd < 1.5e-4
    assert ended >= 6  # about half, by symmetry about zero
    assert below >= 18


@pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux alone")
def test_components_judged_side_by_side_are_those_judged_in_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    data = lc.simulate(arm, poses, noise=lc.Noise({"?P": 1e-4, "phi?": 1e-3}), seed=3).dataset
    start = lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"})
    problem = build_problem(arm, data, start)
    estimate = estimate_noise(problem, components(problem, start), solve)
    in_turn = estimate.components  # small enough
    monkeypatch.setattr(estimation, "_LONG", 0)
    monkeypatch.setattr(estimation, "process_cores", lambda: Forked(2))
    assert replace(estimate).components == in_turn


def test_two_sensors_that_only_show_as_a_sum_are_named() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: x.a + x.b - p.c, {"a": "m", "b": "m"}, {"c": (0.0, "m")}
    )
    rng = np.random.default_rng(1)
    readings = {"a": rng.normal(size=200), "b": rng.normal(size=200)}
    noise = lc.Noise({"a": 0.5, "b": 0.5}, estimate={"?": "each"})
    result = calibrate(machine, readings, noise=noise)
    assert any("'a'" in w and "'b'" in w and "cannot distinguish" in w for w in result.warnings)
    for entry, true in zip(result.noise, (1.0, 1.0), strict=True):
        assert entry.sd_of_sd is None  # any share of the sum fits as well
        assert entry.upper is not None
        assert entry.upper > true


def test_a_sum_is_named_although_one_of_its_parts_ends_at_zero() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: x.a + x.b - p.c, {"a": "m", "b": "m"}, {"c": (0.0, "m")}
    )
    rng = np.random.default_rng(1)
    readings = {"a": rng.normal(size=200), "b": rng.normal(size=200)}
    noise = lc.Noise({"a": 30.0, "b": 0.5}, estimate={"?": "each"})
    result = calibrate(machine, readings, noise=noise)
    assert min(entry.sd for entry in result.noise) == 0.0
    assert any("'a'" in w and "'b'" in w and "cannot distinguish" in w for w in result.warnings)
    for entry in result.noise:
        assert entry.sd_of_sd is None
        assert entry.upper is not None
        assert entry.upper > 1.0


def turned(G: np.ndarray[Any, Any], x: np.ndarray[Any, Any], most: int) -> list[float]:
    """How far the turns x -> G x are from their end after each, mixed."""
    turns, away = list[tuple[Any, Any]](), []
    for _ in range(most):
        turns.append((x, G @ x - x))
        x = x + _mixed(turns)
        away.append(float(np.linalg.norm(x)))
    return away


def test_variances_that_swing_or_spiral_about_their_end_go_to_it() -> None:
    assert turned(-1.5 * np.eye(1), np.ones(1), 2)[-1] < 1e-12  # a secant; alone it runs away
    c, s = np.cos(0.8), np.sin(0.8)  # a spiral, which takes seven turns to a tenth
    spiral = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 0.1]]) * 0.7
    away = turned(spiral, np.ones(3), 6)
    assert away[-1] < 1e-2 * np.linalg.norm(np.linalg.matrix_power(spiral, 6) @ np.ones(3))


def test_a_mixed_step_that_leads_too_far_is_made_as_it_is() -> None:
    slow = [(np.zeros(1), np.array([1.0])), (np.array([1.0]), np.array([0.9]))]
    assert _mixed(slow) == pytest.approx([0.9])  # the secant's zero is nine steps away
    assert len(slow) == 1


def two_alike(shared: float, stated: float = 1.0) -> LinearModel:
    """Two sensors that show in nearly the same direction, of which the first is noisy.

    stated: the sd stated of the second.
    """
    rng = np.random.default_rng(5)
    poses, n = 120, 3
    G = rng.normal(size=(poses, 2, 2))
    G[:, :, 1] = shared * G[:, :, 0] + (1.0 - shared) * G[:, :, 1]
    e = 2.0 * G[:, :, 0] * rng.normal(size=(poses, 1)) + 0.3 * rng.normal(size=(poses, 2))
    G[:, :, 1] *= stated
    fixed = np.broadcast_to(0.09 * np.eye(2), (poses, 2, 2))
    joined = np.concatenate([rng.normal(size=(poses, 2, n)), e[:, :, None]], axis=2)
    block = ModelBlock(joined, fixed, G, np.array([0, 1]))
    return LinearModel((block,), np.zeros(n), np.zeros(n), np.full(2, np.inf))


@pytest.mark.parametrize("stated", [1.0, 1e-4])
def test_a_component_at_zero_is_free_again_when_another_is_dropped(stated: float) -> None:
    """Its likelihood ratio is that of the better of all fits without the other."""
    model = two_alike(0.8, stated)
    found = estimate_ratios(model)
    assert found.ratios[1] == 0.0
    without = without_component(model, found, 0)
    assert without is not None

    def criterion(logarithm: float) -> float:
        at = mixed_fit(model, np.array([0.0, math.exp(logarithm) / stated**2]))
        assert at is not None
        return at.criterion

    best = minimize_scalar(criterion, bounds=(-10, 5), method="bounded")
    at_zero = mixed_fit(model, np.zeros(2))
    assert at_zero is not None
    assert best.fun < at_zero.criterion - 10.0
    assert without == pytest.approx(best.fun, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_ratios_do_not_depend_on_where_the_search_begins(seed: int) -> None:
    model = two_alike(0.5)
    start = np.exp(np.random.default_rng(seed).uniform(-12.0, 6.0, 2))
    found, again = estimate_ratios(model), estimate_ratios(model, start)
    assert again.criterion == pytest.approx(found.criterion, abs=1e-8)
    assert again.ratios == pytest.approx(found.ratios, rel=1e-4)


def test_the_likelihood_ratios_of_the_real_grid_do_not_depend_on_the_sds_stated(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is a second chance given twice from one place: two searches end a little apart."""
    begun: list[np.ndarray[Any, Any]] = []
    run = estimation._Search.run

    def noted(search: Any, ratios: np.ndarray[Any, Any], **how: bool) -> Any:
        begun.append(np.log(np.maximum(ratios, 1e-9)))
        return run(search, ratios, **how)

    monkeypatch.setattr(estimation._Search, "run", noted)
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    columns = {f"theta_{i}": c for i, c in enumerate("SLURBT", 1)} | {k: k for k in "xyz"}
    data = lc.read_dataset(file, columns, pose="pose")
    arm = lc.motoman_ma1400({"x6B": 0.05, "y6B": 0.0, "z6B": -0.45}, before={"rz": math.pi / 2})
    found = []
    for sd in (5e-5, 3e-4):
        noise = lc.Noise({"theta_*": sd, "xyz": 2e-5}, estimate={"theta_*": "each"})
        result = calibrate(arm, data, noise=noise)
        found.append([e.likelihood_ratio for e in result.noise if e.source == "estimated"])
    assert found[0] == pytest.approx(found[1], rel=1e-3, abs=1e-3)
    pairs = [np.abs(one - other).max() for i, one in enumerate(begun) for other in begun[:i]]
    assert len(begun) == 5
    assert sum(pair < 0.1 for pair in pairs) == 1  # both begin at what is stated


def test_a_stated_sd_parts_a_sensor_from_the_machine_at_the_same_point() -> None:
    """Both are white at one point, so only their sum shows; what is stated of the sensor decides,
    to a factor of three, and no sensor vanishes."""
    arm, poses = lc.planar_two_link(), planar_poses()
    data = lc.simulate(arm, poses, noise=lc.Noise({"?P": 1e-4, "phi?": 1e-4}), seed=8).dataset
    sds = []
    for stated in (1e-5, 1e-4, 1e-3):
        noise = lc.Noise({"?P": stated, "phi?": 1e-4, "model": 1e-4}, estimate=WITH_MODEL)
        result = calibrate(arm, data, noise=noise)
        sensor, model = learnt(result)["xP"][0], learnt(result)["model_xP"][0]
        assert math.hypot(sensor, model) == pytest.approx(1e-4, rel=0.15)
        sds.append(sensor)
    assert 5e-6 < sds[0] < 5e-5
    assert sds[1] == pytest.approx(1e-4, rel=0.2)
    assert sds[2] == pytest.approx(1e-4, rel=0.2)  # the sum says that it cannot be more


def test_a_search_that_begins_where_another_ended_ends_there() -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    truth = lc.Noise({"?P": 1e-4, "phi2": 1e-3, "phi3": 0.0})
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"})
    zeros = 0
    for draw in range(4):
        data = lc.simulate(arm, poses, noise=truth, seed=draw).dataset
        problem = build_problem(arm, data, noise)
        stated = components(problem, noise)
        first = estimate_noise(problem, stated, solve)
        again = estimate_noise(problem, stated, solve, begin=first.factors)
        assert list(again.factors.values()) == pytest.approx(list(first.factors.values()), rel=1e-4)
        assert again.solution.status.iterations < first.solution.status.iterations
        zeros += min(first.factors.values()) == 0.0
    assert zeros


def test_sds_that_swing_about_their_end_settle_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits that lead farther past the end than the sds were before it."""
    arm, poses = lc.planar_two_link(), planar_poses()
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-4}, estimate={"?P": "group", "phi?": "group"})
    data = lc.simulate(arm, poses, noise=noise, seed=3).dataset
    problem = build_problem(arm, data, noise)
    stated = components(problem, noise)
    calm = estimate_noise(problem, stated, solve)

    def past(linear: LinearModel, ratios: np.ndarray, *, lowest: np.ndarray) -> Estimate:
        end = estimate_ratios(linear, ratios, lowest=lowest)
        off = np.log(ratios / calm.ratios)
        x, criterion = end.at.x * np.exp(-1.5 * off), end.at.criterion + float(off @ off)
        return replace(end, at=replace(end.at, x=x, criterion=criterion))

    monkeypatch.setattr("loopcal.estimation.noise.variances.estimate_ratios", past)
    found = estimate_noise(problem, stated, solve)
    assert found.settled
    assert list(found.factors.values()) == pytest.approx(list(calm.factors.values()), rel=1e-4)


def test_the_search_ends_with_fits_that_do_not_converge() -> None:
    """Sds learnt where the loops were left say nothing, and more fits from there cost minutes."""
    arm, poses = lc.planar_two_link(), planar_poses()
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"})
    data = lc.simulate(arm, poses, noise=noise, seed=1).dataset
    problem = build_problem(arm, data, noise)
    fits = []

    def hopeless(present: Problem, *, tolerance: float | None = None) -> Solution:
        fits.append(present)
        return solve(present, max_iterations=0)

    found = estimate_noise(problem, components(problem, noise), hopeless)
    assert not found.settled
    assert not found.solution.status.converged
    assert len(fits) == 2


def test_the_model_s_own_error_takes_what_no_sensor_explains() -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    noise = {"?P": 1e-4, "phi?": 1e-4}
    data = lc.simulate(arm, poses, noise=lc.Noise(noise), seed=3).dataset
    rng = np.random.default_rng(4)
    bent = {q: np.array(data[q]) for q in data.quantities}
    for q in ("xP", "yP"):
        bent[q] = bent[q] + rng.normal(scale=2e-3, size=len(data))
    known = lc.Noise({**noise, "model": 1e-4}, estimate={"model": "group"})
    result = calibrate(arm, bent, noise=known)
    sd, sd_of_sd = learnt(result)["model_xP"]
    assert sd_of_sd is not None
    assert abs(sd - 2e-3) < 4 * sd_of_sd
    assert any("limits the accuracy" in w for w in result.warnings)
    roles = {q: entry.role for entry in result.noise for q in entry.quantities}
    assert {q for q, role in roles.items() if role == "disturbance"} == {"model_xP", "model_yP"}
    assert result.accuracy_after is not None
    assert result.calibrated.description == arm.description


def test_a_disturbed_machine_is_the_machine_where_the_disturbance_is_zero() -> None:
    arm = lc.motoman_ma1400()
    disturbed = with_model_error(arm)
    assert disturbed.quantity_group("model") == ("model_x", "model_y", "model_z")
    assert with_model_error(disturbed) is disturbed
    own = lc.Mechanism.from_function(lambda x, p: x.a * p.g - 1.0, {"a": "1"}, {"g": (1.0, "1")})
    assert with_model_error(own).tape.quantities == ("a", "model_loop 1")


def test_the_real_grid_tells_its_encoders_apart(shared_data: Callable[[str], Path]) -> None:
    """Independent estimates: 73 over one encoder sd, 93 over one end-point sd."""
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    columns = {f"theta_{i}": c for i, c in enumerate("SLURBT", 1)} | {k: k for k in "xyz"}
    data = lc.read_dataset(file, columns, pose="pose")
    arm = lc.motoman_ma1400({"x6B": 0.05, "y6B": 0.0, "z6B": -0.45}, before={"rz": math.pi / 2})

    def criterion(noise: lc.Noise) -> float:
        result = calibrate(arm, data, noise=noise, method="reweighted")
        assert result.restricted_criterion is not None
        return result.restricted_criterion

    tracker = {"xyz": 5e-6}
    each = criterion(lc.Noise({"theta_*": 5e-5} | tracker, estimate={"theta_*": "each"}))
    common = criterion(lc.Noise({"theta_*": 5e-5} | tracker, estimate={"theta_*": "group"}))
    point = criterion(lc.Noise({"theta_*": 0.0, "xyz": 5e-5}, estimate={"xyz": "group"}))
    assert common - each > 65
    assert point - each > 85


def test_what_cannot_be_estimated_is_refused() -> None:
    arm, poses = lc.planar_two_link(), planar_poses()
    data = lc.simulate(arm, poses, noise=lc.Noise({"*": 1e-3}), seed=1).dataset
    with refused("missing-sd"):
        calibrate(arm, data, noise=lc.Noise({"*": 1e-3, "phi2": 0}, estimate={"phi2": "each"}))
    with refused("unknown-name", "'theta_1'"):
        calibrate(arm, data, noise=lc.Noise({"*": 1e-3}, estimate={"theta_1": "each"}))
    with refused("unknown-name", "'all'"):
        lc.Noise({"*": 1e-3}, estimate={"*": "all"})
    shared = lc.Noise({"phi?": 1e-3, ("xP", "yP"): 1e-8 * np.eye(2)}, estimate={"xP": "each"})
    with refused("invalid-covariance"):
        calibrate(arm, data, noise=shared)


def test_what_no_pose_of_a_part_reads_leaves_the_sd_of_the_others_to_learn() -> None:
    """As a marker that only images of another fold show."""
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.a - p.c, x.b - p.c], {"a": "m", "b": "m"}, {"c": (0.0, "m")}
    )
    readings = {"a": np.random.default_rng(1).normal(size=200), "b": np.full(200, np.nan)}
    noise = lc.Noise({"a": 0.5, "b": 0.5}, estimate={"?": "group"})
    sd, stated = learnt(calibrate(machine, readings, noise=noise, method="implicit-loop"))["a"]
    assert abs(sd - 1.0) < 3 * (stated or 0.0)


@pytest.mark.parametrize("case", SMALL[:3], ids=str)
def test_the_bound_of_a_small_noise_holds_it(case: SmallNoise) -> None:
    """`analyses/variance_components.py` does the same, and a fourth case, at full size."""
    bounds = np.array([b for b in case.bounds(range(30)) if b is not None])
    assert len(bounds) > 12
    assert np.mean(bounds >= 1.0) >= 0.9
    assert np.median(bounds) < 3.0  # and is of use


def test_the_bound_of_one_sd_of_equal_readings_is_that_of_chi_squared() -> None:
    """Where theory has it: n readings of one mean, S / quantile of n - 1 degrees."""
    machine = lc.Mechanism.from_function(lambda x, p: x.a - p.c, {"a": "m"}, {"c": (0.0, "m")})
    readings = {"a": np.random.default_rng(3).normal(size=6)}
    noise = lc.Noise({"a": 1.0}, estimate={"a": "each"})
    problem = build_problem(machine, lc.Dataset.from_arrays(readings), noise)
    model = linear_model(problem, np.zeros(1), np.zeros((1, 6)), [[0]])
    bound = upper_bound(model, estimate_ratios(model), 0)
    sum_of_squares = float(np.square(readings["a"] - readings["a"].mean()).sum())
    assert bound == pytest.approx(sum_of_squares / chdtri(5, 0.975), rel=1e-3)
