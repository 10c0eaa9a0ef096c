"""Steps and drifts of a parameter over its calibrations, against machines whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from analyses.histories import drifting, over, scattering, stepped, unchanged
from loopcal.companions.life.courses import Course, changes, events_before, walk_variance


@pytest.mark.parametrize("number", [2, 8])
def test_a_machine_that_does_not_change_is_reported_in_at_most_five_percent(number: int) -> None:
    rng = np.random.default_rng(number)
    assert np.mean([unchanged(rng, number) for _ in range(100)]) <= 0.05


def test_a_step_is_found_dated_and_sized() -> None:
    rates = over(150, lambda rng: stepped(rng, 8, 10.0))
    assert rates.share("none") <= 0.01
    assert rates.share("step") > 0.75
    assert rates.share("drift", "wander") <= 0.05
    assert rates.dated >= 0.95 * rates.ways["step"]
    assert rates.held >= 0.9 * rates.ways["step"]


def test_a_step_at_an_event_is_named_more_often_and_never_a_drift() -> None:
    at_event = over(150, lambda rng: stepped(rng, 8, 6.0, True))
    assert at_event.share("step") > over(150, lambda rng: stepped(rng, 8, 6.0)).share("step")
    assert at_event.share("drift", "wander") <= 0.02


def test_a_drift_is_found_and_its_interval_holds() -> None:
    rates = over(150, lambda rng: drifting(rng, 8, 20.0))
    assert rates.share("drift") > 0.9
    assert rates.share("step") <= 0.05
    assert rates.held >= 0.93 * rates.ways["drift"]


def test_sds_that_are_too_small_make_neither_step_nor_drift() -> None:
    rates = over(150, lambda rng: scattering(rng, 16, 3.0))
    assert rates.share("step", "drift", "wander") <= 0.05
    assert rates.share("scatter") > 0.5


def test_a_step_within_a_drift_is_found_beside_it() -> None:
    t = np.linspace(0.0, 3.0, 16)
    noise = np.random.default_rng(1).normal(size=16)
    values = noise + 20.0 * t / 3.0 + 20.0 * (np.arange(16) >= 9)
    step, drift = changes(Course(t, values, np.ones(16)), 20)
    assert (step.way, step.after, step.before) == ("step", 8, 9)
    assert step.half is not None
    assert abs(step.size - 20.0) <= step.half
    assert drift.way == "drift"
    assert drift.half is not None
    assert abs(drift.size - 20.0) <= drift.half


def test_two_calibrations_tell_no_step_from_a_drift() -> None:
    (change,) = changes(Course(np.array([0.0, 1.0]), np.array([0.0, 20.0]), np.ones(2)), 20)
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
        course = Course(t, y, np.full(len(t), 0.1))
        variances.append(walk_variance(course, {int(np.argmax(t > 2.0))}))
    assert np.mean(variances) == pytest.approx(0.09, rel=0.15)


def test_events_lie_between_calibrations() -> None:
    assert events_before([0.0, 10.0, 20.0], [-1.0, 5.0, 30.0]) == {1}
    # of an event on the day of a calibration it is not known which came first
    assert events_before([0.0, 10.0, 20.0], [10.0]) == {1, 2}
