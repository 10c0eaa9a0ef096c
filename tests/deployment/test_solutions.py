"""The joints of a program's poses are those that a search for each of them alone gives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from analyses import corrected as loops
from analyses.gauntlet_truth import drawn
from loopcal.companions.robot import inverse as module
from loopcal.companions.robot.arms import ArmPose, Arms, arms_of
from loopcal.companions.robot.inverse import solutions
from loopcal.companions.robot.rigid import tool_of

Array = NDArray[np.float64]
NAMES = ["six-axis", "UR-like", "SCARA"]


@cache
def arms(name: str) -> Arms:
    arm = loops.drawing(loops.ARMS[name])
    nominal = {p.name: p.nominal for p in arm.parameters}
    return arms_of(arm, nominal, tool_of(arm, nominal, "calibrated"))


def program(name: str, count: int, kind: str) -> Array:
    """Poses (count, 4, 4) anywhere, or along a path through some of these."""
    q = drawn(loops.BOXES[name], count if kind == "random" else 4, np.random.default_rng(2))
    if kind == "path":
        at = np.linspace(0.0, len(q) - 1.0, count)
        q = np.array([np.interp(at, np.arange(len(q)), column) for column in q.T]).T
    return arms(name).controller(q)


def apart(found: Array, others: Array) -> float:
    """The largest distance of joints (m, n) from those of another set (m, n), whole turns aside."""
    off = np.abs(np.remainder(found[:, None] - others + np.pi, 2 * np.pi) - np.pi).max(axis=2)
    return float(max(off.min(axis=1).max(), off.min(axis=0).max()))


@pytest.mark.parametrize("kind", ["random", "path"])
@pytest.mark.parametrize("name", NAMES)
def test_a_pose_has_the_joints_that_many_starts_for_it_alone_give(
    name: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_SEARCHED", 20)
    poses = program(name, 30, kind)
    together, alone = solutions(arms(name), poses), module._searched(arms(name), poses)
    assert [len(joints) for joints in together] == [len(joints) for joints in alone]
    assert max(map(apart, together, alone)) < 1e-7


def evaluations(poses: Array, monkeypatch: pytest.MonkeyPatch) -> int:
    """How often a pose and its derivatives are evaluated in a search for these poses."""
    counts, moving = list[int](), ArmPose.moving

    def counted(arm: ArmPose, q: Array) -> tuple[Array, Array]:
        counts.append(len(q))
        return moving(arm, q)

    with monkeypatch.context() as patch:
        patch.setattr(ArmPose, "moving", counted)
        solutions(arms("six-axis"), poses)
    return sum(counts)


def test_equal_poses_cost_one_search(monkeypatch: pytest.MonkeyPatch) -> None:
    (pose,) = program("six-axis", 1, "random")
    alike = np.broadcast_to(pose, (500, 4, 4))
    once = evaluations(alike[:1], monkeypatch)
    assert evaluations(alike, monkeypatch) == once


@pytest.mark.parametrize("kind", ["random", "path"])
def test_a_further_pose_costs_a_tenth_of_a_search(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_SEARCHED", 40)
    poses = program("six-axis", 160, kind)
    searched = np.unique(np.linspace(0, 159, 40).astype(int))
    alone = evaluations(poses[searched], monkeypatch)
    further = evaluations(poses, monkeypatch) - alone
    assert further / (160 - 40) < 0.1 * alone / 40
