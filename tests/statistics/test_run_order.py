"""What the order of the poses can tell apart from the joints."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.statistics.run_order import order_by_joints, path_cosines
from tests.reference.simulated import planar_arm

Array = NDArray[np.float64]
RNG = np.random.default_rng(4)
T = np.linspace(0.0, 1.0, 150)[:, None]
RANDOM = RNG.uniform(-1.5, 1.5, (150, 6))
PATH = np.sin(2.0 * np.pi * RNG.uniform(2.0, 5.0, 6) * T + RNG.uniform(0.0, 6.0, 6))
SWEEP = np.column_stack([T[:, 0], RANDOM[:, 1:]])
GRID = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("joints", [PATH, SWEEP, GRID], ids=["path", "sweep", "grid"])
def test_joints_that_follow_the_order_tell_it(joints: Array) -> None:
    assert order_by_joints(joints) > 0.9


def test_in_random_order_joints_tell_nothing_and_with_few_poses_all() -> None:
    found = [order_by_joints(RNG.permutation(RANDOM)) for _ in range(50)]
    assert abs(np.mean(found)) < 0.02
    assert max(found) < 0.3
    assert order_by_joints(RANDOM[:28]) == 1.0


def test_a_joint_that_stands_still_says_nothing() -> None:
    parked = np.column_stack([RANDOM, np.full(150, 0.3)])
    assert order_by_joints(parked) == pytest.approx(order_by_joints(RANDOM), abs=1e-12)
    assert path_cosines(np.full((30, 2), 1.0)) == 0


def test_only_a_path_is_described_by_cosines_and_a_faster_one_by_more() -> None:
    assert [path_cosines(joints) for joints in (RANDOM, SWEEP, GRID)] == [0, 0, 0]
    slow = np.sin(2.0 * np.pi * 1.3 * T + np.arange(6.0))
    assert 6 < path_cosines(slow) < path_cosines(PATH) <= 50


@pytest.mark.parametrize(
    ("ordered", "again", "told"),
    [(True, 0, True), (True, 3, False), (False, 0, False)],
    ids=["sorted", "sorted, three again", "random"],
)
def test_check_says_where_the_joints_tell_the_order(ordered: bool, again: int, told: bool) -> None:
    arm = planar_arm(60)
    poses = arm.read({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}, 1)
    if ordered:
        rows = np.argsort(poses["phi2"])
        poses = poses.take(np.append(rows, rows[:again]))
    found = lc.check(arm.truth, poses)
    codes = [one.code for one in found.findings if one.question == "sound"]
    assert codes == ["order-by-joints"] * told
    assert ("of the pose order" in str(found)) is told
    assert found.verdict == lc.check(arm.truth, arm.read(seed=1)).verdict
