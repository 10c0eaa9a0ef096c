"""By how much the readings of another day scatter more than stated."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_worlds import World
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.change_tests import what_changed
from loopcal.statistics.day_noise import DayNoise

WORLD = World("six", poses=120)
SEEDS = range(4)


@cache
def days(seed: int) -> tuple[lc.Result, dict[str, np.ndarray], list[str]]:
    """A calibration by every second pose, the other poses, and the joints."""
    trial = WORLD.made(np.random.default_rng(seed))
    first, second = (
        {name: np.array(row)[k::2] for name, row in trial.readings.items()} for k in (0, 1)
    )
    made = lc.calibrate(trial.mechanism, first, noise=trial.noise, method="implicit-loop")
    return made, second, [q for q in second if q not in trial.inside.outputs]


def read(
    seed: int, joints: float = 1.0, others: float = 1.0, zero: float = 0.0
) -> dict[str, np.ndarray]:
    """A day whose errors are so many times as large; zero: by which that of J3 has moved."""
    result, second, turning = days(seed)
    rng, readings = np.random.default_rng([7, seed]), {n: row.copy() for n, row in second.items()}
    sds = {q: one.sd for one in result.document.noise for q in one.quantities}
    for name, row in readings.items():
        times = joints if name in turning else others
        row += np.sqrt(times**2 - 1.0) * sds[name] * rng.standard_normal(len(row))
    readings[turning[2]] += zero
    return readings


def learnt(seed: int, joints: float = 1.0, others: float = 1.0, zero: float = 0.0) -> DayNoise:
    result, readings = days(seed)[0], read(seed, joints, others, zero)
    day = Day.of(Calibrated.of(result, "").stationed, lc.Dataset.from_arrays(readings), None)
    explained = what_changed(day, day.linearised())
    assert explained is not None
    return DayNoise.of(explained.linear, explained.every)


def test_a_day_as_the_calibration_scatters_as_stated() -> None:
    made = [learnt(seed) for seed in SEEDS]
    assert not any(one.larger for one in made)


@pytest.mark.parametrize(("joints", "others"), [(8.0, 1.0), (1.0, 8.0)])
def test_what_scatters_is_told_from_the_rest(joints: float, others: float) -> None:
    made = [learnt(seed, joints, others) for seed in SEEDS]
    assert all([*one.larger] == ["joints" if joints > 1.0 else "readings"] for one in made)
    ratios = [(one.joints / joints, one.others / others) for one in made]
    # 60 poses show a sd to about a tenth, and the other one hardly beside it.
    larger = [ratio[int(others > 1.0)] for ratio in ratios]
    assert np.allclose(np.mean(np.log(larger)), 0.0, atol=0.15)
    assert np.allclose(np.log(larger), 0.0, atol=0.4)


def test_a_zero_that_moved_is_no_scatter() -> None:
    assert not any(learnt(seed, zero=2e-3).larger for seed in SEEDS)
    both = [learnt(seed, joints=8.0, zero=2e-3) for seed in SEEDS]
    assert all([*one.larger] == ["joints"] for one in both)


def test_a_sd_that_the_calibration_hardly_knew_says_no_scatter() -> None:
    """Of 5 degrees of freedom a variance is 4 times too small in a hundredth of all cases."""
    for seed in SEEDS:
        result, readings = days(seed)[0], read(seed, joints=2.0)
        day = Day.of(Calibrated.of(result, "").stationed, lc.Dataset.from_arrays(readings), None)
        explained = what_changed(day, day.linearised())
        assert explained is not None
        made = [
            DayNoise.of(explained.linear, explained.every, learnt)
            for learnt in ((np.inf, np.inf), (200.0, 5.0), (5.0, 200.0))
        ]
        assert [[*one.larger] for one in made] == [["joints"], ["joints"], []]


def test_what_is_placed_anew_is_as_unsure_as_readings_scatter() -> None:
    """Beside the same poses without that scatter, which are sure by far less."""
    z = []
    for seed in SEEDS:
        result = days(seed)[0]
        as_stated, shaken = (lc.verify(result, read(seed, times)) for times in (1.0, 8.0))
        assert shaken.changes is not None
        assert [*shaken.changes.scatter] == ["joints"]
        for one, other in zip(as_stated.placed, shaken.placed, strict=True):
            assert other.sd is not None
            z.append((other.value - one.value) / other.sd)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4
