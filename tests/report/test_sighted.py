"""The points in the report's picture are those of all instruments."""

from __future__ import annotations

import numpy as np

from loopcal.report.sighted import Sighting, joined


def test_of_a_pose_that_several_see_the_first_one_counts() -> None:
    nan = np.nan
    first = Sighting(
        "a", np.array([[1.0, nan, nan, 4.0]] * 3), np.array([[0.1, nan, nan, nan]] * 3)
    )
    other = Sighting(
        "b", np.array([[5.0, 6.0, nan, nan]] * 3), np.array([[0.5, 0.6, nan, nan]] * 3)
    )
    both = joined([first, other])
    assert both is not None
    np.testing.assert_array_equal(both.at[0], [1.0, 6.0, nan, 4.0])
    np.testing.assert_array_equal(both.along[2], [0.1, 0.6, nan, nan])


def test_an_error_counts_before_a_place_alone() -> None:
    nan = np.nan
    place = Sighting("a", np.array([[1.0, 2.0]] * 3), np.full((3, 2), nan))
    error = Sighting("b", np.array([[5.0, nan]] * 3), np.array([[0.5, nan]] * 3))
    both = joined([place, error])
    assert both is not None
    np.testing.assert_array_equal(both.at[0], [5.0, 2.0])
    assert joined([]) is None
