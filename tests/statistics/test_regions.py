"""Stated regions hold where nothing was measured: arms that sag, unknown to the user."""

from __future__ import annotations

import numpy as np

from analyses.regions import corners, drawn
from tests.statistics.test_pose_delay import calibrated


def test_regions_hold_outside_the_corner_that_was_measured_or_the_verdict_refuses() -> None:
    draws = [drawn(corners(50, 0.35, stated=False), seed, "least-squares") for seed in range(5)]
    inside = np.mean([draw.inside.share for draw in draws])
    assert 0.92 <= inside <= 0.98
    for draw in draws:
        assert draw.near
        assert draw.outside.share > 0.85
        assert draw.outside.sd > 2.0 * draw.inside.sd


def test_small_turns_of_a_body_whose_pose_is_read_do_not_stand_still() -> None:
    document = calibrated(0).document
    assert document.prediction is not None
    region = document.prediction.region
    assert region is not None
    assert {"wx", "wy", "wz"} <= {one.quantity for one in region.ranges}
    assert region.parked == ()
