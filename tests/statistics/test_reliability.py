"""What single readings can hide, and which sensor the corrections speak against."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.problem.problem import build_problem
from loopcal.statistics.pose_tests import Fitted, pose_tests
from loopcal.statistics.reliability import noncentrality
from tests.reference.simulated import ma1400, planar_arm
from tests.reference.verdicts import verdict_of

ARM = planar_arm(poses=25)
SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 3e-4}
NOISE = lc.Noise(SDS)
SPATIAL = ma1400(60)
SPATIAL_SDS = {q: 1e-5 if q in "xyz" else 5e-5 for q in SPATIAL.exact}


def fitted(data, noise=NOISE, **how) -> Any:
    return lc.calibrate(ARM.truth, data, noise=noise, **({"method": "implicit-loop"} | how))


def hidden(result) -> Any:
    return lc.reliability(result)


def told(result) -> Any:
    return lc.findings(result)


def test_redundancy_numbers_add_up_to_the_degrees_of_freedom_and_squares_to_chi_squared():
    data = ARM.read(SDS, 1)
    joint = lc.Noise({"phi2": 1e-4, "phi3": 3e-4, ("xP", "yP"): [[2e-8, 1e-8], [1e-8, 3e-8]]})
    for noise in (NOISE, joint):
        result = fitted(data, noise)
        entries = result.document.noise
        assert sum(e.redundancy for e in entries) == pytest.approx(result.freedom, rel=1e-9)
        squares = sum(e.redundancy * e.variance_factor for e in entries)
        assert squares == pytest.approx(result.chi_squared.value, rel=1e-6)


@pytest.mark.parametrize("wrong", ["theta_1", "theta_4", "x", "z"])
def test_the_sensor_whose_sd_is_too_small_has_the_largest_factor(wrong):
    """Its share in chi-squared goes by its weight: a tracker five times as bad as stated has the
    smallest share of all."""
    true = SPATIAL_SDS | {wrong: 5 * SPATIAL_SDS[wrong]}
    start = SPATIAL.off(2e-3, 4e-3)
    for seed in range(2):
        data = SPATIAL.read(true, seed)
        result = lc.calibrate(start, data, noise=lc.Noise(SPATIAL_SDS), method="implicit-loop")
        worst = max(result.document.noise, key=lambda e: e.variance_factor or 0.0)
        assert worst.quantities == (wrong,)
        assert wrong in verdict_of(result.document).sound.words


def test_an_error_of_the_detectable_size_is_found_with_the_stated_power():
    """One reading of each of 200 draws is wrong by it; only linear algebra differs per draw."""
    exact = fitted(ARM.read())
    found = hidden(exact)
    assert found.noncentrality == noncentrality() == pytest.approx(3.29053 + 0.84162, abs=1e-5)
    problem, solution = exact.problem, exact.solution
    rng = np.random.default_rng(5)
    names = problem.mechanism.tape.quantities
    hits = 0
    for _ in range(200):
        i, j = rng.integers(25), rng.integers(4)
        noise = np.array([rng.normal(0.0, SDS[q], 25) for q in names])
        noise[j, i] += found.detectable[names[j]][i] * rng.choice([-1, 1])
        here = replace(problem, readings=problem.readings + noise)
        # the linear fit: what is left of the errors after the parameters took their part
        result = fitted(lc.Dataset.from_arrays(dict(zip(names, here.readings, strict=True))))
        fit = Fitted(
            result.solution.parameters,
            result.solution.corrections,
            solution.spectrum.covariance(),
            1.0,
        )
        tests = pose_tests(result.problem, fit, np.ones(25, dtype=bool))
        hits += abs(tests.w[j, i]) > 3.2905
    assert abs(hits / 200 - 0.8) < 3 * np.sqrt(0.8 * 0.2 / 200)


def test_the_effect_is_what_an_error_of_this_size_does_to_predictions():
    data = ARM.read()
    before = fitted(data)
    found = hidden(before)
    for quantity, i in (("phi2", 3), ("phi3", 17), ("xP", 8)):
        # a thousandth of it, so that the change is linear
        wrong = {q: v.copy() for q, v in data.readings.items()}
        wrong[quantity][i] += 1e-3 * found.detectable[quantity][i]
        after = fitted(lc.Dataset.from_arrays(wrong))
        predicted = [np.array(list(lc.predict(r, data).outputs.values())) for r in (before, after)]
        moved = np.sqrt(np.square(predicted[1] - predicted[0]).sum(axis=0).mean())
        assert found.effect[quantity][i] == pytest.approx(1e3 * moved, rel=2e-3)


def test_detectable_errors_agree_with_the_tests_of_poses_for_every_method():
    data = ARM.read(SDS, 3)
    for method in ("implicit-loop", "least-squares"):
        result = fitted(data, method=method)
        found = hidden(result)
        exact = method == "least-squares"
        factor = result.solution.chi_squared / result.freedom if exact else 1.0
        fit = Fitted(
            result.solution.parameters,
            result.solution.corrections,
            result.spectrum.covariance(),
            factor,
        )
        tests = pose_tests(result.problem, fit, np.ones(25, dtype=bool))
        for j, quantity in enumerate(result.problem.mechanism.tape.quantities):
            expected = found.noncentrality * tests.sd[j]
            np.testing.assert_allclose(found.detectable[quantity], expected, rtol=1e-9)


def test_a_reading_that_nothing_controls_can_hide_any_error():
    """Three poses give six equations for six parameters: nothing is left to test."""
    data = ARM.read(SDS, 1).take(np.arange(3))
    found = hidden(fitted(data)).entry
    assert all(one.readings == 0 and one.uncontrolled == 3 for one in found.sensors)
    assert found.worst is None
    assert found.lines() == []


def test_the_document_holds_the_worst_of_each_sensor():
    result = fitted(ARM.read(SDS, 1))
    found = told(result).reliability
    entry = lc.Result.of(result).document.reliability
    assert entry is not None
    one = next(s for s in entry.sensors if s.quantity == "phi3")
    worst = int(np.argmax(found.effect["phi3"]))
    assert (one.pose, one.effect) == (found.poses[worst], found.effect["phi3"][worst])
    assert entry.lines()[0].startswith("reliability: an undetected error of")
    problem = build_problem(ARM.truth, ARM.read(SDS, 1), NOISE)
    assert {s.quantity for s in entry.sensors} == set(problem.mechanism.tape.quantities)
