"""Angles that no sensor reads are found from the loops, wherever they stand."""

from __future__ import annotations

import numpy as np

import loopcal as lc
from loopcal.estimation.calibrate import calibrate

PLANAR = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}


def planar_readings(seed: int) -> lc.Dataset:
    rng = np.random.default_rng(seed)
    turns = {"phi2": rng.uniform(-3, 3, 150), "phi3": rng.uniform(0.3, 2.8, 150)}
    truth = {"xA": 0.01, "yA": -0.02, "l2": 0.801, "l3": 0.598, "phi20": 0.02, "phi30": 0.0}
    made = lc.simulate(lc.planar_two_link(), turns, noise=lc.Noise(PLANAR), seed=seed, truth=truth)
    return made.dataset


def test_a_joint_without_encoder_costs_only_what_it_would_have_told() -> None:
    readings = planar_readings(3)
    without = {q: readings[q] for q in ("xP", "yP", "phi2")}
    arm = lc.planar_two_link()
    arm = arm.with_parameters(arm.parameters.with_fixed(["phi30"]))  # nothing could tell it
    blind = lc.Noise({**PLANAR, "phi3": np.inf})
    result = calibrate(arm, without, noise=blind)
    full = calibrate(arm, readings, noise=lc.Noise(PLANAR))
    assert result.status.converged
    for name in ("xA", "yA", "l2", "l3", "phi20"):
        assert abs(result.value[name] - full.value[name]) < 4 * (result.sd[name] or 0.0)
        assert (result.sd[name] or 0.0) > 0.999 * (full.sd[name] or 0.0)


def test_a_parameter_that_an_unread_angle_makes_up_for_is_not_identifiable() -> None:
    readings = planar_readings(4)
    without = {q: readings[q] for q in ("xP", "yP", "phi2")}
    noise = lc.Noise({**PLANAR, "phi3": np.inf})
    result = calibrate(lc.planar_two_link(), without, noise=noise)
    assert result.status.converged
    assert [list(u.combination) for u in result.identifiability.not_identifiable] == [["phi30"]]
    assert result.value["phi30"] == 0.0
    assert result.sd["phi30"] == np.inf


def test_a_lost_reading_of_a_joint_is_bridged_from_any_angle() -> None:
    readings = planar_readings(5)
    gaps = np.array(readings["phi3"])
    gaps[::7] = np.nan  # the neighbours are poses somewhere else: interpolation is far off
    lost = {q: gaps if q == "phi3" else readings[q] for q in readings.quantities}
    result = calibrate(lc.planar_two_link(), lost, noise=lc.Noise(PLANAR))
    assert result.status.converged
    found = result.corrections["phi3"][::7] + np.interp(
        np.arange(0, 150, 7), np.flatnonzero(~np.isnan(gaps)), gaps[~np.isnan(gaps)]
    )
    reach = np.cos(found + result.value["phi30"]) - np.cos(
        readings["phi3"][::7] + result.value["phi30"]
    )
    assert np.abs(reach).max() < 0.02  # the elbow may lie on either side, the reach is the same
    assert result.chi_squared is not None
    assert (result.chi_squared.p_value or 0) > 1e-3
