"""A change of a whole machine is followed, and what is kept is as unsure as it makes it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import null_space

import loopcal as lc
from analyses.followed import Days, rigidly
from loopcal.companions.life.drift import drift_of_conditions
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated


@cache
def days(draw: int) -> tuple[Days, lc.Result]:
    made = Days.of("six", "stated", draw)
    return made, made.calibrated("stated")


def grown(readings: dict[str, np.ndarray], growth: float) -> dict[str, np.ndarray]:
    """Points of a machine all of whose lengths grew: its station takes up where it stands."""
    return {q: (1.0 + growth) * v if q in "xyz" else v for q, v in readings.items()}


def test_an_unchanged_machine_has_no_drift_of_conditions() -> None:
    made, first = days(0)
    calibrated = Calibrated.of(first, "").stationed
    day = Day.of(calibrated, lc.Dataset.from_arrays(made.later.readings), made.later.noise)
    assert drift_of_conditions(day).shape == (len(calibrated.mechanism.parameters), 0)


@pytest.mark.parametrize("warms", [True, False])
def test_a_machine_that_warms_up_along_a_run_is_named_with_its_size(warms: bool) -> None:
    made, first = days(0)
    read = {q: v[:40] for q, v in made.fresh.readings.items()}
    noise = np.random.default_rng(5).normal(0.0, 2e-5, (3, 40))
    share = np.linspace(0.0, 1.0, 40)
    true = dict(zip("xyz", made.fresh.true[:40].T, strict=True))
    stands = {one.name: one.value for one in lc.verify(first, read | true).placed}
    for (q, at), row in zip(true.items(), noise, strict=True):
        base = stands[f"base_{q}"]
        read[q] = base + (1.0 + 2e-4 * warms * share) * (at - base) + row
    check = lc.verify(first, read)
    assert check.verdict["consistent"].passed is not warms
    points = check.shifts.found
    assert [one.moved for one in points] == ["expansion"] * warms
    if warms:
        (change,) = points[0].changes.values()
        assert change.size == pytest.approx(2e-4, rel=0.2)
        assert "the scale of the machine drifted" in check.verdict["consistent"].words
        assert "ppm" in check.verdict["consistent"].words


@pytest.mark.parametrize("tool", [True, False])
@pytest.mark.parametrize("draw", [1, 3, 5])
def test_the_scale_of_a_warm_machine_is_stated_whether_or_not_its_tool_is_as_warm(
    draw: int, tool: bool
) -> None:
    """What the tool grows looks like more growth of the arm, in part."""
    made = Days.of("seven", "stated", draw)
    first, growth = made.calibrated("stated"), 3e-4
    lengths = {p.name for p in first.mechanism.parameters if p.dimension == "length"}
    warm = lengths | {"tool_x", "tool_y", "tool_z"} if tool else lengths
    truth = {n: v * (1.0 + growth * (n in warm)) for n, v in first.value.items()}
    joints = {q: made.later.readings[q] for q in made.joints}
    day = lc.simulate(first.mechanism, joints, noise=made.later.noise, seed=draw, truth=truth)
    read = day.dataset.readings
    changes = lc.verify(first, read).changes
    assert changes is not None
    (change,) = changes.found
    assert change.kind == "expansion"
    assert change.low < growth < change.high
    assert change.high - change.low < 0.5 * growth


@pytest.mark.parametrize("draw", [0, 1, 2])
def test_a_machine_that_grew_is_followed_with_honest_sds(draw: int) -> None:
    made, first = days(draw)
    updated = lc.update(first, grown(made.later.readings, 2e-4))
    fresh = grown(made.fresh.readings, 2e-4)
    true = (1.0 + 2e-4) * made.fresh.true

    def error(result: lc.Result) -> tuple[float, float]:
        """Rms distance at fresh poses, and what the covariance says [m]."""
        predicted = lc.predict(result, fresh)
        points = np.column_stack([predicted.outputs[q] for q in "xyz"])
        off = rigidly(points, true) - true
        stated = np.trace(predicted.covariance, axis1=1, axis2=2)
        return float(np.sqrt(np.square(off).sum(axis=1).mean())), float(np.sqrt(stated.mean()))

    off, stated = error(updated)
    assert off < 0.6 * error(first)[0]
    assert off < 1.2 * stated
    assert any("The update estimates the scale of the machine" in w for w in updated.warnings)
    # The same readings are those of a machine as it was, by an instrument whose scale changed.
    true = made.fresh.true
    off, stated = error(updated)
    assert off < 1.5 * stated
    verdict = updated.verdict
    assert verdict is not None
    sound = verdict.sound
    assert (sound.code, sound.passed) == ("scale-since", None)
    (scale,) = updated.document.scales or ()
    assert scale.size == pytest.approx(2e-4, rel=0.2)


def test_learnt_sds_of_outputs_count_where_an_update_learnt_them() -> None:
    """Of a calibration that takes its joints as exact: the learnt sd holds their noise."""
    made, _ = days(0)
    joints = dict.fromkeys(made.joints, 0.0)
    points = dict.fromkeys("xyz", 5e-5)
    noise = lc.Noise(joints | points, estimate=dict.fromkeys("xyz", "group"))
    first = lc.calibrate(
        made.first.mechanism, made.first.readings, noise=noise, method="implicit-loop"
    )
    updated = lc.update(first, made.later.readings)
    learnt = next(entry.sd for entry in updated.noise if "x" in entry.quantities)
    predicted = lc.predict(updated, made.fresh.readings)
    assert (np.diagonal(predicted.covariance, axis1=1, axis2=2) > learnt**2).all()


def test_the_scales_are_the_likeliest_of_dense_matrices() -> None:
    """Of a machine that grew; by the likelihood of what the placement leaves, on a grid."""
    made, first = days(0)
    calibrated = Calibrated.of(first, "").stationed
    data = lc.Dataset.from_arrays(grown(made.later.readings, 5e-4))
    day = Day.of(calibrated, data, made.later.noise)
    linear, steps = day.linearised(), drift_of_conditions(day)
    J = linear.placement.J / np.sqrt(linear.factor)
    K = null_space(linear.F.T)

    def criterion(sd: float, factor: float) -> float:
        grown_by = K.T @ np.hstack([linear.A, factor * J @ steps])
        V = sd**2 * np.eye(K.shape[1]) + grown_by @ grown_by.T
        e = K.T @ linear.e
        return float(np.linalg.slogdet(V)[1] + e @ np.linalg.solve(V, e))

    assert steps.size
    at = min(criterion(sd, 1.0) for sd in np.linspace(1.0, 2.0, 21))
    for factor in (0.5, 0.8, 1.25, 2.0):
        assert at < min(criterion(sd, factor) for sd in np.linspace(1.0, 2.0, 21)) + 0.05
