"""What the noise of two trackers is told as; `analyses/two_trackers.py` at full size."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from analyses.two_trackers import Found, run

DRAWS = 120
NOISE = 4.5 * np.sqrt(2 / DRAWS)
"""The mean square of so many normal numbers is within this of 1, one time in 150,000 excepted."""


@cache
def found(way: str) -> Found:
    return run(way, range(DRAWS))


def test_range_and_angles_tell_the_same_as_full_covariances_of_coordinates() -> None:
    native, covariance = found("native"), found("covariance")
    assert np.abs(native.errors - covariance.errors).max() < 2e-3 * native.sds.max()
    assert covariance.sds == pytest.approx(native.sds, rel=2e-3)


def test_one_sd_for_all_coordinates_costs_more_than_half_again() -> None:
    worse = found("one isotropic").spread / found("native").spread
    assert np.median(worse) > 1.5


@pytest.mark.parametrize("way", ["native", "covariance"])
def test_the_stated_sds_of_the_true_noise_are_right(way: str) -> None:
    squares = np.square(found(way).errors / found(way).sds).mean(axis=0)
    assert np.abs(squares - 1.0).max() < NOISE


def test_the_stated_sds_of_isotropic_noise_are_wrong() -> None:
    """Too small where angles decide, too large where the range does."""
    its = found("one isotropic")
    squares = np.square(its.errors / its.sds).mean(axis=0)
    assert squares.max() > 1.0 + NOISE
    assert squares.min() < 1.0 - NOISE
