"""What a check calls weak, cured by further poses."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.planning.cure import Cure, cure
from loopcal.mechanisms.planar import planar_two_link

NEAR = {"phi2": (0.0, 0.05), "phi3": (1.0, 1.05)}
WIDE = {"phi2": (-1.0, 1.0), "phi3": (0.3, 2.0)}
NOISE = lc.Noise({"phi*": 1e-4, "xP": 1e-5, "yP": 1e-5})


@cache
def alike() -> lc.Dataset:
    """Twelve poses that hardly differ."""
    exact = {"*": 0.0}
    return lc.simulate(
        planar_two_link(), lc.random_poses(NEAR, 12, seed=1), noise=exact, seed=1
    ).dataset


def with_cure(found: Cure) -> lc.Check:
    """The check of the poses measured and those added."""
    both = {q: np.concatenate([alike()[q], found.poses[q]]) for q in ("phi2", "phi3")}
    data = lc.simulate(planar_two_link(), both, noise={"*": 0.0}, seed=1).dataset
    return lc.check(planar_two_link(), data, noise=NOISE)


def test_poses_that_cure_raise_the_verdict_to_good_and_not_one_of_them_is_too_many() -> None:
    assert lc.check(planar_two_link(), alike(), noise=NOISE).verdict != "good"
    found = cure(planar_two_link(), alike(), NOISE, lc.PlanSettings(WIDE))
    assert found.enough
    after = with_cure(found)
    assert after.verdict == "good"
    assert after.identifiability.condition_number == pytest.approx(found.condition, rel=1e-3)
    short = Cure(found.poses.take(np.arange(len(found.poses) - 1)), None, False)
    if len(short.poses):
        assert with_cure(short).verdict != "good"
    assert f"{len(found.poses)} more pose" in str(found)
    assert len(found.document()["poses"]) == len(found.poses)


def test_poses_as_near_as_those_measured_cure_nothing() -> None:
    found = cure(planar_two_link(), alike(), NOISE, lc.PlanSettings(NEAR))
    assert not found.enough
    assert "would not cure" in str(found)
