"""Sds from repeated readings: unbiased, with the sd they claim; drift, grids, correlation seen."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import InputError
from loopcal.measurements.resolution import grid
from loopcal.statistics.repeats import FEWEST
from loopcal.statistics.repeats_summary import noise_table, sentence, summary
from tests.refusals import refused

DRAWS = 800


def series(*columns: np.ndarray, unit: str | None = None) -> lc.Dataset:
    names = "abcdef"[: len(columns)]
    table = dict(zip(names, columns, strict=True))
    return lc.Dataset.from_arrays(table, units=dict.fromkeys(names, unit) if unit else None)


@pytest.mark.parametrize("lengths", [(20,), (6, 8, 12)])
def test_sds_are_unbiased_and_as_uncertain_as_they_say(lengths):
    rng = np.random.default_rng(1)
    found = [
        lc.repeated_readings([series(i + 2.0 * rng.normal(size=n)) for i, n in enumerate(lengths)])
        for _ in range(DRAWS)
    ]
    for pick in (lambda s: s.about_mean, lambda s: s.without_drift):
        scatters = [pick(f["a"]) for f in found]
        sds = np.array([s.sd for s in scatters])
        assert np.sqrt(np.mean(sds**2)) == pytest.approx(2.0, rel=0.03)
        assert np.mean([s.sd_of_sd for s in scatters]) == pytest.approx(sds.std(), rel=0.08)
        inside = np.mean([s.low < 2.0 < s.high for s in scatters])
        assert 0.93 < inside < 0.97


@pytest.mark.parametrize("lengths", [(8,), (20,), (10, 20, 15)])
def test_false_alarms_of_drift_and_heterogeneity_are_as_rare_as_stated(lengths):
    rng = np.random.default_rng(2)
    p_values = np.array(
        [
            [
                s.drift_p_value,
                s.slow_p_value,
                s.alternating_p_value,
                1.0 if s.homogeneity_p_value is None else s.homogeneity_p_value,
            ]
            for _ in range(DRAWS)
            for s in lc.repeated_readings([series(rng.normal(size=n)) for n in lengths]).sensors
        ]
    )
    for level in (0.1, 0.05):
        rate = (p_values < level).mean(axis=0)
        assert np.all(rate[:3] > 0.7 * level)
        # Levene's test about medians keeps its level, and is careful in short series
        assert np.all(rate < level + 4 * np.sqrt(level / DRAWS))


def test_drift_is_told_apart_from_scatter():
    rng, n = np.random.default_rng(3), 40
    straight = [
        lc.repeated_readings(series(0.1 * np.arange(n) + rng.normal(size=n)))["a"]
        for _ in range(200)
    ]
    slow = [
        lc.repeated_readings(series(np.cumsum(0.5 * rng.normal(size=n)) + rng.normal(size=n)))["a"]
        for _ in range(200)
    ]
    for found, power in ((straight, 0.99), (slow, 0.7)):
        assert np.mean([s.drifts for s in found]) > power
        assert np.mean([s.about_mean.sd for s in found]) > 1.35
        rms = np.sqrt(np.mean([s.without_drift.sd**2 for s in found]))
        assert rms == pytest.approx(1.0, abs=0.08)
    slopes = [s.drift[0] for s in straight]
    assert np.mean(slopes) == pytest.approx(0.1, abs=0.002)
    assert np.mean([s.sd_of_drift[0] for s in straight]) == pytest.approx(np.std(slopes), rel=0.15)
    assert straight[0].sd == straight[0].without_drift.sd
    assert "drift" in sentence(straight[0])


def test_readings_that_alternate_are_named():
    values = np.where(np.arange(20) % 2, 1.0, -1.0) + np.random.default_rng(4).normal(0, 0.2, 20)
    found = lc.repeated_readings(series(values))["a"]
    assert found.alternating_p_value is not None
    assert found.alternating_p_value < 1e-4
    assert "two sides" in sentence(found)
    assert not found.drifts


def test_correlated_sensors_are_found_and_others_are_not():
    rng, seen, false = np.random.default_rng(5), 0, 0
    for _ in range(300):
        common, own = rng.normal(size=20), rng.normal(size=(3, 20))
        found = lc.repeated_readings(series(common + 0.5 * own[0], common + 0.5 * own[1], own[2]))
        pairs = {c.sensors for c in found.correlated}
        seen += ("a", "b") in pairs
        false += bool(pairs - {("a", "b")})
    assert seen > 270
    assert false < 12
    assert "real motion" in summary(found)


def test_a_series_in_which_a_joint_was_parked_says_nothing_of_its_noise():
    rng = np.random.default_rng(6)
    a, still = np.round(rng.normal(size=20), 4), np.full(20, 3.1234)
    found = lc.repeated_readings([series(a), series(still)])["a"]
    assert found.parked == 1
    assert found.sd == pytest.approx(a.std(ddof=1), rel=1e-12)
    assert found.by_series == pytest.approx((a.std(ddof=1), 0.0))
    assert "without one series in which it never changed" in sentence(found)


def test_a_sensor_whose_steps_hide_its_noise_is_not_parked_where_it_stands_still():
    coarse = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    found = lc.repeated_readings([series(coarse), series(np.full(10, 2.0))])["a"]
    assert found.parked == 0
    assert found.about_mean.degrees == 18


def test_rows_in_which_a_reflector_was_lost_are_refused():
    rng = np.random.default_rng(3)
    x, y, q = (far + 1e-5 * rng.normal(size=20) for far in (1.2, -0.8, 0.0))
    x[7] = y[7] = x[9] = y[9] = 0.0
    with refused("lost-reflector", "0 in", "2 of", "20 poses"):
        lc.repeated_readings(series(x, y, q))


def test_coarse_readings_near_zero_are_no_lost_reflector():
    counts = np.array([0.0, 1.0, 0.0, 1.0, 1.0, 2.0])
    assert lc.repeated_readings(series(counts, counts))["a"].sd > 0


def test_means_of_series_do_not_matter_and_series_that_differ_are_named():
    rng = np.random.default_rng(6)
    a, b = rng.normal(size=20), 6.0 * rng.normal(size=20)
    apart = lc.repeated_readings([series(a + 100), series(b - 50)])["a"]
    expected = np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / 2)
    assert apart.about_mean.sd == pytest.approx(expected, rel=1e-12)
    assert apart.by_series == pytest.approx((a.std(ddof=1), b.std(ddof=1)))
    assert apart.homogeneity_p_value is not None
    assert apart.homogeneity_p_value < 1e-3
    assert "the series differ" in sentence(apart)


def test_counts_behind_written_decimals_are_found():
    rng = np.random.default_rng(7)
    count = 12.17e-6
    for sd in (1e-5, 2e-5, 5e-5):
        values = np.round(np.round((0.3 + sd * rng.normal(size=20)) / count) * count, 6)
        step = grid(values).step
        assert step is not None
        assert step / count == pytest.approx(round(step / count), abs=0.08)
    free = [grid(np.round(rng.normal(0, 2e-5, 20), 6)).step for _ in range(300)]
    assert np.mean(np.array(free) == 1e-6) > 0.99
    assert grid(rng.normal(size=20)).step is None


def test_a_step_wider_than_the_scatter_gives_the_sd():
    still = lc.repeated_readings(series(np.array([30.1, 30.1, 30.1, 30.1]), unit="deg"))["a"]
    assert still.about_mean.sd == 0.0
    assert still.sd == pytest.approx(np.radians(0.1) / np.sqrt(12))
    assert "rounding" in sentence(still)
    now_and_then = [30.1] * 19 + [30.2]
    coarse = lc.repeated_readings(series(np.array(now_and_then), unit="deg"))["a"]
    assert coarse.sd == coarse.rounding_sd


def test_rounding_is_recognised_as_the_uniform_distribution_it_is():
    rng = np.random.default_rng(8)
    true = np.cumsum(rng.uniform(0, 3, 4000))
    found = lc.repeated_readings(series(np.round(true) - true, unit="deg"))["a"]
    assert found.about_mean.sd == pytest.approx(np.radians(1 / np.sqrt(12)), rel=0.03)


def test_rows_without_a_reading_are_left_out():
    values = np.array([1.0, np.nan, 2.0, 3.0, np.nan, 2.0])
    found = lc.repeated_readings(series(values))["a"]
    assert found.about_mean.degrees == 3
    assert found.about_mean.sd == pytest.approx(np.nanstd(values, ddof=1))


def test_a_column_that_never_changes_and_is_zero_gives_no_sd():
    found = lc.repeated_readings(series(np.zeros(5)))
    assert "cannot be estimated" in sentence(found["a"])
    assert noise_table(found) == "[noise]\n# a: it never changed, so its sd is unknown"


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        [series(np.arange(FEWEST - 1.0))],
        [series(np.arange(5.0)), series(np.arange(5.0), np.arange(5.0))],
    ],
)
def test_what_cannot_be_used_is_refused_with_a_remedy(wrong):
    with pytest.raises(InputError) as caught:
        lc.repeated_readings(wrong)
    assert caught.value.remedy
