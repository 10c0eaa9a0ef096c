"""Bad poses that support each other bend a fit; they are named all the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import loopcal as lc
from tests.reference.simulated import planar_arm

ARM = planar_arm(60)
SDS = dict.fromkeys(ARM.exact, 1e-4)
START = ARM.off(2e-3, 4e-3)
POINT = 1.7e-4
"""About the sd of a point beside the one computed from the joints."""
HOW: dict[str, Any] = {
    "stated": {"method": "implicit-loop", "noise": lc.Noise(SDS)},
    "learnt": {"method": "implicit-loop", "noise": lc.Noise(SDS, estimate={"*": "group"})},
    "least squares": {"method": "least-squares"},
}


def in_a_corner(draw: int, number: int, sds: float) -> tuple[lc.Dataset, set[str]]:
    """The poses nearest to a corner of the joint space, all off by the same vector."""
    data, rng = ARM.read(SDS, seed=1000 + draw), np.random.default_rng(9000 + draw)
    outputs = ARM.truth.outputs
    joints = np.array([v for q, v in data.readings.items() if q not in outputs])
    box = (joints - joints.min(axis=1, keepdims=True)) / np.ptp(joints, axis=1)[:, None]
    corner = rng.integers(0, 2, len(box))
    bad = np.argsort(np.square(box - corner[:, None]).sum(axis=0))[:number]
    off = rng.normal(size=len(outputs))
    off *= sds * POINT / np.linalg.norm(off)
    readings = {q: v.copy() for q, v in data.readings.items()}
    for q, shift in zip(outputs, off, strict=True):
        readings[q][bad] += shift
    return lc.Dataset.from_arrays(readings), {data.poses[i] for i in bad}


@pytest.mark.parametrize("how", HOW)
def test_a_quarter_of_bad_poses_in_a_corner_is_named(how: str) -> None:
    for draw in range(3):
        data, bad = in_a_corner(draw, 15, 30.0)
        result = lc.calibrate(START, data, **HOW[how])
        assert {o.pose for o in lc.find_outliers(result).found} == bad


def test_without_the_named_poses_intervals_hold_the_truth() -> None:
    held: list[bool] = []
    for draw in range(8):
        data, _ = in_a_corner(draw, 15, 30.0)
        found = lc.find_outliers(lc.calibrate(START, data, **HOW["stated"]))
        rest = data.exclude({o.pose for o in found.found})
        fit = lc.calibrate(START, rest, **HOW["stated"])
        sds = np.sqrt(np.diag(fit.covariance))
        off = [fit.value[n] - ARM.values[n] for n in fit.estimated]
        held += (np.abs(off) < 1.96 * sds).tolist()
    # 6 parameters of 8 draws
    assert np.mean(held) > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 16)


def test_learnt_sds_of_good_data_name_hardly_anything() -> None:
    named = 0
    for draw in range(12):
        result = lc.calibrate(START, ARM.read(SDS, draw), **HOW["learnt"])
        named += bool(lc.find_outliers(result).found)
    assert named <= 2
