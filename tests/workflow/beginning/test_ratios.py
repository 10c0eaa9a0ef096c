"""Ratios of drives that are not as the controller has them are named, with the command."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_days import made
from analyses.gauntlet_kinds import KINDS
from analyses.layouts import World, described, of, predicted_error, written, xyz
from analyses.lives_truth import write_readings

Changes = dict[tuple[int, int], float]


def _written(folder: Path, world: World, changes: Changes) -> tuple[Path, np.ndarray]:
    """Readings q with which joint i stands at q_i + k q_j, and those of the fresh poses."""
    described(world, folder)
    n = world.q.shape[1]
    K = np.eye(n)
    for (i, j), k in changes.items():
        K[i, j] += k
    shown = world.shown(world.read @ np.linalg.inv(K).T)
    names = [f"J{i + 1}" for i in range(n)]
    columns = {**of(names, shown), **xyz("{}", world.points)}
    fresh = world.shown(world.fresh @ np.linalg.inv(K).T)
    return folder / written(folder / "a.csv", columns), fresh


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({(3, 3): 0.02}, "J4 reads"),
        ({(5, 4): 0.03}, "J6 moves with J5 too"),
        ({(4, 3): -0.02, (5, 4): 0.03}, "and J6 moves with J5 too"),
    ],
)
def test_a_ratio_is_named_and_its_command_mends_it(
    tmp_path: Path, changes: Changes, words: str
) -> None:
    world = World("six", 7, poses=60)
    data, fresh = _written(tmp_path, world, changes)
    with pytest.raises(lc.InputError) as caught:
        lc.init(data, dh=tmp_path / "dh.csv")
    assert words in str(caught.value)
    option, columns = caught.value.options
    assert option == "--joints"
    made = lc.init(data, dh=tmp_path / "dh.csv", joints=columns, out=tmp_path)
    assert made.written
    read = of([f"J{i + 1}" for i in range(6)], fresh)
    assert predicted_error(tmp_path, read, world.target(world.fresh)) < 1e-4


def test_stated_columns_are_taken_as_they_are(tmp_path: Path) -> None:
    data, _ = _written(tmp_path, World("six", 7, poses=60), {(3, 3): 0.02})
    assert lc.init(data, dh=tmp_path / "dh.csv", joints="J1,J2,J3,J4,J5,J6").mechanism


@pytest.mark.parametrize("robot", ["six", "ur", "gantry"])
def test_drives_with_the_stated_ratios_are_no_fault(tmp_path: Path, robot: str) -> None:
    for seed in (11, 12):
        data, _ = _written(tmp_path, World(robot, seed, poses=40), {})
        assert lc.init(data, dh=tmp_path / "dh.csv").mechanism


def test_a_soft_arm_has_the_stated_ratios(tmp_path: Path) -> None:
    """It sinks by up to 5 mrad as it reaches out: as if J3 moved with J2 too, by 0.7 %."""
    user = KINDS["two stations"].machine(17104)
    rng = np.random.default_rng([zlib.crc32(b"two stations"), 17104])
    day, _ = made(user, user.poses, rng, None, None, user.stations)
    write_readings(tmp_path / "day-1.csv", user, day.joints, day.points, day.columns)
    option, file = user.description(tmp_path)
    assert option == "--urdf"
    assert lc.init(tmp_path / "day-1.csv", urdf=tmp_path / file).mechanism
