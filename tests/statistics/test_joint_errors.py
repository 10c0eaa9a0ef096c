"""Errors of joints that are the same wherever a joint stands the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_worlds import World
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.joint_errors import JointErrors

WORLD = World("six", poses=160, learnt=True)
JOINTS = tuple(f"theta_{i}" for i in range(1, 7))
ROOT = Path(__file__).resolve().parents[2]


@cache
def days(waving: bool, seed: int) -> tuple[lc.Result, dict[str, np.ndarray]]:
    """A calibration by every second pose, and the other poses; waving: every joint errs by up to
    0.1 mrad as it turns, a few times over its range."""
    rng = np.random.default_rng(seed)
    trial = WORLD.made(rng)
    readings = {name: np.array(row) for name, row in trial.readings.items()}
    for name in [q for q in readings if q not in trial.inside.outputs]:
        wave = np.sin(rng.uniform(6.0, 9.0) * readings[name] + rng.uniform(0.0, 6.0))
        readings[name] += 1e-4 * wave * waving
    first, second = ({n: row[k::2] for n, row in readings.items()} for k in (0, 1))
    result = lc.calibrate(trial.mechanism, first, noise=trial.noise, method="implicit-loop")
    return result, second


def learnt(waving: bool, seed: int) -> JointErrors:
    result, readings = days(waving, seed)
    data = lc.Dataset.from_arrays(readings)
    linear = Day.of(Calibrated.of(result, "").stationed, data, None).linearised()
    made = JointErrors.of(linear, np.zeros((len(linear.e), 0)))
    assert made is not None
    return made


def test_the_share_that_is_a_function_of_the_joints_is_learnt() -> None:
    none = [learnt(False, seed) for seed in range(3)]
    some = [learnt(True, seed) for seed in range(3)]
    assert np.mean([one.share for one in none]) < 0.25
    assert np.mean([one.share for one in some]) > 0.5
    assert all(0.0 < one.sd < 0.3 for one in none + some)


def test_planes_of_a_grid_that_were_not_calibrated_are_no_change(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same machine in the same hour, at every third pose and at the next ones; and with the
    zero of a joint moved by 0.05 deg."""
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(file.parents[1]))
    project = lc.read_project(ROOT / "examples/motoman/left_arm_grid.toml")
    data = lc.load_dataset(project).dataset
    first, second = (data.take(np.arange(k, len(data), 3)) for k in (0, 1))
    noise = lc.Noise({"theta_*": 5e-5}, estimate={JOINTS: "group"})
    how = {"method": "implicit-loop", "model_error": "structured"}
    result = lc.calibrate(project.mechanism, first, noise=noise, **how)
    found = lc.verify(result, second)
    assert found.verdict["consistent"].code == "unchanged", str(found)
    moved = second.with_readings({"theta_3": second["theta_3"] + np.radians(0.05)})
    changed = lc.verify(result, moved).changes
    assert changed is not None
    assert [one.name for one in changed.found] == ["theta_3"]
