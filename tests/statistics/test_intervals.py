"""Confidence intervals by covariance and by profile."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics.intervals import Interval, covariance_interval, interval_entries, intervals
from tests.reference.simulated import planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
ARM = planar_arm(30)


def bent(x: Any, p: Any) -> tuple[Any]:
    """A straight line whose slope is the exponential of a parameter: y = exp(k) t."""
    return (np.exp(p.k) * x.t - x.y,)


def exponential(prior_sd: float = math.inf) -> lc.Mechanism:
    return lc.Mechanism.from_function(
        bent,
        quantities={"t": "1", "y": "1"},
        parameters={"k": lc.Parameter("k", 0.2, "1", prior_sd)},
        outputs=("y",),
    )


T = np.linspace(0.1, 1.0, 8)
Y = math.exp(0.3) * T + np.random.default_rng(3).normal(0.0, 0.5, 8)
LINE = lc.Noise({"t": 0.0, "y": 0.5})


def known(interval: Interval | None) -> Interval:
    assert interval is not None
    return interval


def ends(interval: Interval | None) -> tuple[float, float]:
    found = known(interval)
    assert found.profile_low is not None
    assert found.profile_high is not None
    return found.profile_low, found.profile_high


def test_a_bent_parameter_has_the_interval_of_what_is_straight() -> None:
    # exp(k) enters linearly: its interval, and with it that of k, is known in closed form.
    result = lc.calibrate(exponential(), {"t": T, "y": Y}, noise=LINE, method="implicit-loop")
    slope, sd = float(T @ Y / (T @ T)), float(0.5 / np.sqrt(T @ T))
    found = intervals(result)["k"]
    expected = [math.log(slope - 1.959964 * sd), math.log(slope + 1.959964 * sd)]
    assert ends(found) == pytest.approx(expected, abs=5e-3 * sd / slope)
    assert known(found).differs
    assert known(found).low == pytest.approx(result.value["k"] - 1.959964 * sd / slope, rel=1e-6)


def test_a_side_on_which_chi_squared_never_rises_is_open() -> None:
    # With little slope exp(k) -> 0 fits as well: nothing bounds k from below.
    flat = lc.Noise({"t": 0.0, "y": 3.0})
    result = lc.calibrate(exponential(), {"t": T, "y": Y}, noise=flat, method="implicit-loop")
    found = known(intervals(result)["k"])
    assert found.profile_low is None
    assert found.profile_high is not None
    assert found.differs


def test_a_prior_takes_part() -> None:
    result = lc.calibrate(exponential(0.1), {"t": T, "y": Y}, noise=LINE, method="implicit-loop")

    def chi_squared(k: float) -> float:
        return float(np.square((Y - math.exp(k) * T) / 0.5).sum() + ((k - 0.2) / 0.1) ** 2)

    assert result.chi_squared is not None
    assert chi_squared(result.value["k"]) == pytest.approx(result.chi_squared.value)
    for end in ends(intervals(result)["k"]):
        assert chi_squared(end) - result.chi_squared.value == pytest.approx(3.8415, abs=0.01)


def test_least_squares_counts_in_residual_variances() -> None:
    y = math.exp(0.3) * T + 0.3 * (Y - math.exp(0.3) * T)
    result = lc.calibrate(exponential(), {"t": T, "y": y}, method="least-squares")
    slope = float(T @ y / (T @ T))
    variance = float(np.square(y - slope * T).sum()) / 7
    t = 2.364624  # Student's t of 7 degrees of freedom, 97.5 %
    half = t * math.sqrt(variance / float(T @ T))
    expected = [math.log(slope - half), math.log(slope + half)]
    assert ends(intervals(result)["k"]) == pytest.approx(expected, abs=2e-3 * half)


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_small_noise_makes_both_the_same(method: str) -> None:
    noise = lc.Noise(SDS) if method == "implicit-loop" else None
    result = lc.calibrate(ARM.truth, ARM.read(SDS, seed=2), noise=noise, method=method)
    found = intervals(result, ["l?", "xA"])
    assert list(found) == ["xA", "l2", "l3"]
    for name, interval in found.items():
        its = known(interval)
        assert not its.differs
        sd = result.sd[name]
        assert sd is not None
        assert ends(interval) == pytest.approx([its.low, its.high], abs=0.02 * sd)


def test_large_noise_is_followed_to_both_ends() -> None:
    sds = {q: 30.0 * sd for q, sd in SDS.items()}
    result = lc.calibrate(
        ARM.truth, ARM.read(sds, seed=3), noise=lc.Noise(sds), method="implicit-loop"
    )
    assert result.chi_squared is not None
    low, high = ends(intervals(result, "l2")["l2"])
    for end in (low, high):
        held = ARM.truth.with_nominal({"l2": end}).parameters.with_fixed(["l2"])
        machine = ARM.truth.with_parameters(held)
        again = lc.calibrate(machine, result.dataset, noise=lc.Noise(sds), method="implicit-loop")
        assert again.chi_squared is not None
        rise = again.chi_squared.value - result.chi_squared.value
        assert rise == pytest.approx(3.8415, abs=0.01)


def test_what_nothing_bounds_has_no_interval() -> None:
    arm = ARM.truth.with_parameters(ARM.truth.parameters.with_fixed(["l3"]))
    exact = SDS | {"phi3": 0.0}
    joints = {q: v for q, v in ARM.exact.items() if q == "phi2"}
    made = lc.simulate(arm, {**joints, "phi3": np.zeros(30)}, noise=lc.Noise(exact), seed=1)
    result = lc.calibrate(arm, made.dataset, noise=lc.Noise(exact), method="implicit-loop")
    found = intervals(result)
    assert found["l3"] is None
    assert found["phi30"] is None
    assert found["xA"] is not None
    assert covariance_interval(result, "phi30") is None


def test_the_summary_and_the_document_tell_it() -> None:
    result = lc.calibrate(exponential(), {"t": T, "y": Y}, noise=LINE, method="implicit-loop")
    entries = interval_entries(intervals(result))
    document = result.with_parts(intervals=entries).document
    assert "differs" in str(document)
    entry = document.parameters[0].interval
    assert entry is not None
    assert entry.differs is True
    low, high = entry.covariance[0], entry.profile[1]
    assert low is not None
    assert high is not None
    assert low < result.value["k"] < high


def test_what_nothing_bounds_is_shown_without_ends() -> None:
    result = lc.calibrate(exponential(), {"t": T, "y": Y}, noise=LINE, method="implicit-loop")
    document = result.with_parts(intervals=interval_entries({"k": None})).document
    entry = document.parameters[0].interval
    assert entry is not None
    assert entry.covariance == entry.profile == (None, None)
    assert "unbounded" in str(document)


def test_what_cannot_be_profiled_is_refused() -> None:
    data, noise = ARM.read(SDS, seed=2), lc.Noise(SDS)
    result = lc.calibrate(ARM.truth, data, noise=noise, method="reweighted")
    with refused("unsupported", "'reweighted'"):
        intervals(result)
    result = lc.calibrate(ARM.truth, data, noise=noise, method="implicit-loop")
    with refused("unknown-name", "'l9'"):
        intervals(result, "l9")
    with refused("invalid-value", "95"):
        intervals(result, level=95.0)
    stopped = lc.calibrate(
        ARM.truth, data, noise=noise, max_iterations=1, start={"l2": 5.0}, method="implicit-loop"
    )
    with refused("not-converged"):
        intervals(stopped)
    robust = lc.calibrate(ARM.truth, data, noise=noise, loss="huber", method="implicit-loop")
    with refused("unsupported", "loss"):
        intervals(robust)
