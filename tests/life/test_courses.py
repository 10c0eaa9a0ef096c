"""Steps and drifts of a machine over its calibrations, against machines whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from analyses.histories import (
    PARAMETERS,
    covariance,
    drifting,
    over,
    scattering,
    stepped,
    unchanged,
)
from loopcal.companions.life.courses import (
    Cause,
    Course,
    Said,
    changes,
    events_before,
    walk_variance,
)


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("number", [2, 8])
def test_a_machine_that_does_not_change_is_reported_in_at_most_five_percent(
    number: int, correlated: bool
) -> None:
    rng = np.random.default_rng(number)
    assert np.mean([unchanged(rng, number, correlated) for _ in range(40)]) <= 0.05


def test_a_step_is_found_dated_and_sized() -> None:
    rates = over(30, lambda rng: stepped(rng, 8, 10.0))
    assert rates.share("none") <= 0.01
    assert rates.share("step") > 0.75
    assert rates.share("drift", "wander") <= 0.05
    assert rates.dated >= 0.95 * rates.ways["step"]
    assert rates.held >= 0.9 * rates.ways["step"]
    assert rates.alone >= 0.95 * rates.draws


def test_a_step_of_half_an_sd_of_any_single_parameter_is_found() -> None:
    """Single calibrations determine no parameter, and combinations a hundred times better."""
    rates = over(40, partial(stepped, number=8, size=1.0, correlated=True))
    assert rates.share("none") <= 0.05
    assert rates.dated >= 0.95 * rates.ways["step"]
    assert rates.held >= 0.9 * rates.ways["step"]
    assert rates.among >= 0.95 * rates.draws


def test_a_step_at_an_event_is_named_more_often_and_never_a_drift() -> None:
    at_event = over(30, lambda rng: stepped(rng, 8, 6.0, True))
    assert at_event.share("step") > over(30, lambda rng: stepped(rng, 8, 6.0)).share("step")
    assert at_event.share("drift", "wander") <= 0.02


def test_a_drift_is_found_and_its_interval_holds() -> None:
    rates = over(25, lambda rng: drifting(rng, 8, 20.0))
    assert rates.share("drift") > 0.9
    assert rates.share("step") <= 0.05
    assert rates.held >= 0.93 * rates.ways["drift"]


def test_sds_that_are_too_small_make_neither_step_nor_drift() -> None:
    rates = over(12, lambda rng: scattering(rng, 16, 3.0))
    assert rates.share("step", "drift", "wander") <= 0.05
    assert rates.share("scatter") > 0.5


def _of(t: np.ndarray, values: np.ndarray, C: np.ndarray, *causes: Cause) -> Course:
    """Calibrations with one covariance."""
    n = len(C)
    said = tuple(Said.of(value, C, np.arange(n), n) for value in values)
    return Course(t, said, causes)


def test_a_step_within_a_drift_is_found_beside_it() -> None:
    t = np.linspace(0.0, 3.0, 16)
    noise = np.random.default_rng(1).normal(size=16)
    values = noise + 20.0 * t / 3.0 + 20.0 * (np.arange(16) >= 9)
    step, drift = changes(Course.of_one(t, values, np.ones(16)))
    assert (step.way, step.after, step.before) == ("step", 8, 9)
    assert step.half is not None
    assert abs(step.size - 20.0) <= step.half
    assert drift.way == "drift"
    assert drift.half is not None
    assert abs(drift.size - 20.0) <= drift.half


def test_what_cannot_be_told_apart_is_named_together() -> None:
    """Two parameters of which calibrations see the sum alone."""
    rng, C = np.random.default_rng(2), np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1e-4 * np.eye(2)
    values = rng.multivariate_normal(np.zeros(2), C, 8)
    values[4:, 0] += 0.5
    one = np.eye(2)
    (change,) = changes(
        _of(np.arange(8.0), values, C, Cause("a", "1", one[:, :1]), Cause("b", "1", one[:, 1:]))
    )
    assert set(change.causes) == {0, 1}
    assert (change.way, change.at) == ("step", 4)
    assert change.half is not None
    assert abs(change.size - 0.5) <= change.half


def test_what_is_mounted_anew_each_day_hides_no_step() -> None:
    rng, C = np.random.default_rng(3), covariance(np.random.default_rng(4), True)
    values = rng.multivariate_normal(np.zeros(PARAMETERS), C, 12)
    values[:, 1:4] += 30.0 * rng.normal(size=(12, 3))
    values[7:, 0] += 2.0
    one = np.eye(PARAMETERS)
    tool = Cause("tool", "1", one[:, 1:4])
    others = [Cause(f"p_{i}", "1", one[:, [i]]) for i in (0, *range(4, PARAMETERS))]
    found = changes(_of(np.arange(12.0), values, C, tool, *others))
    assert {(one.way, one.causes) for one in found} == {("step", (1,)), ("scatter", (0,))}
    assert found[0].at == 7


def test_other_terms_of_the_model_are_no_change() -> None:
    """Every second calibration chose other terms, which moves a parameter by ten sds."""
    rng, one = np.random.default_rng(6), np.eye(3)
    values = rng.normal(size=(12, 3))
    values[::2, 0] += 10.0
    values[7:, 1] += 10.0
    causes = [Cause(f"p_{i}", "1", one[:, [i]]) for i in range(3)]
    alternating = _of(np.arange(12.0), values, one, *causes)
    assert {c.way for c in changes(alternating) if c.causes[0] == 0} == {"scatter"}
    models = tuple(i % 2 for i in range(12))
    (change,) = changes(replace(alternating, models=models))
    assert (change.way, change.causes, change.at) == ("step", (1,), 7)


def test_a_calibration_that_lacks_a_parameter_says_nothing_of_it() -> None:
    rng, one, said = np.random.default_rng(5), np.eye(2), []
    for i in range(8):
        at = np.array([0, 1] if i % 2 else [1])
        value = rng.normal(size=2) + np.array([10.0 * (i >= 4), 0.0])
        said.append(Said.of(value[at], np.eye(len(at)), at, 2))
    causes = Cause("a", "1", one[:, :1]), Cause("b", "1", one[:, 1:])
    (change,) = changes(Course(np.arange(8.0), tuple(said), causes))
    assert change.causes == (0,)
    assert change.size == pytest.approx(10.0, abs=3.0)


def test_two_calibrations_tell_no_step_from_a_drift() -> None:
    (change,) = changes(Course.of_one(np.array([0.0, 1.0]), np.array([0.0, 20.0]), np.ones(2)))
    assert change.way == "open"
    assert (change.after, change.before) == (0, 1)
    assert change.size == pytest.approx(20.0)
    assert change.half == pytest.approx(1.96 * np.sqrt(2.0), rel=1e-3)


def test_a_random_walk_is_found_in_the_mean_without_its_steps() -> None:
    rng, t = np.random.default_rng(1), np.linspace(0.0, 5.0, 20)
    variances = []
    for _ in range(150):
        walk = np.concatenate([[0.0], np.cumsum(rng.normal(0.0, 0.3 * np.sqrt(np.diff(t))))])
        y = walk + rng.normal(0.0, 0.1, len(t)) + 5.0 * (t > 2.0)
        course = Course.of_one(t, y, np.full(len(t), 0.1))
        variances.append(walk_variance(course, {int(np.argmax(t > 2.0))}))
    assert np.mean(variances) == pytest.approx(0.09, rel=0.15)


def test_events_lie_between_calibrations() -> None:
    assert events_before([0.0, 10.0, 20.0], [-1.0, 5.0, 30.0]) == {1}
    # of an event on the day of a calibration it is not known which came first
    assert events_before([0.0, 10.0, 20.0], [10.0]) == {1, 2}
