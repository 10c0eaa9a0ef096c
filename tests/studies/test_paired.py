"""Two methods on the same draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from loopcal.companions.studies.tables import binomial_interval, paired


@pytest.mark.parametrize(("wins", "draws"), [(0, 20), (20, 20), (7, 20), (970, 1000)])
def test_the_interval_is_the_exact_one(wins: int, draws: int) -> None:
    exact = binomtest(wins, draws).proportion_ci(method="exact")
    np.testing.assert_allclose(binomial_interval(wins, draws), (exact.low, exact.high), atol=1e-12)


def test_the_ratio_and_its_interval():
    rng = np.random.default_rng(3)
    second = rng.standard_normal((400, 1))
    first = 0.1 * second
    mixed = 0.5 * rng.standard_normal((400, 1))
    found = paired(("a", "b"), ("l",), (first, second), seed=1).advantages[0]
    assert found.closer == 1.0
    assert found.ratio == pytest.approx(0.1)
    assert found.ratio_high - found.ratio_low < 1e-12  # type: ignore[operator]
    found = paired(("a", "b"), ("l",), (mixed, second), seed=1).advantages[0]
    # sd of the log of a ratio of independent rms errors: 1 / sqrt(draws)
    width = np.log(found.ratio_high / found.ratio_low)  # type: ignore[operator]
    assert width == pytest.approx(2 * 1.96 / np.sqrt(400), rel=0.1)
    assert found.ratio_low < 0.5 < found.ratio_high  # type: ignore[operator]
    assert 0.5 < found.closer < 0.9


def test_draws_in_which_one_failed_take_no_part():
    first = np.array([[1.0], [np.nan], [1.0]])
    second = np.array([[2.0], [0.0], [1.0]])
    found = paired(("a", "b"), ("l",), (first, second), seed=1)
    assert found.draws == 2
    assert found.advantages[0].closer == 0.75  # a tie counts half
    assert paired(("a", "b"), ("l",), (first[1:2], second[1:2]), seed=1).advantages == ()
