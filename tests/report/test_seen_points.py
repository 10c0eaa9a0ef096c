"""The points in the report's picture are those of all instruments of one station."""

from __future__ import annotations

import numpy as np

from loopcal.report.drawn import SeenPoints


def test_of_a_pose_that_several_see_the_first_one_counts() -> None:
    nan = np.nan
    first = SeenPoints(np.array([[1.0, nan, nan]] * 3), np.array([[0.1, nan, nan]] * 3))
    other = SeenPoints(np.array([[5.0, 6.0, nan]] * 3), np.array([[0.5, 0.6, nan]] * 3))
    both = first.beside(other)
    np.testing.assert_array_equal(both.at[0], [1.0, 6.0, nan])
    np.testing.assert_array_equal(both.along[2], [0.1, 0.6, nan])
