"""Degrees of freedom of learnt covariances: against closed forms and simulated variances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from loopcal.small_samples import LearntCovariance, f_limit, f_tail, t_quantile

PHI = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])


def test_a_residual_variance_has_the_degrees_of_the_residuals() -> None:
    scaled = LearntCovariance.scaled(PHI, 7)
    np.testing.assert_allclose(scaled.freedom, 7.0)
    assert scaled.denominator == pytest.approx(7.0)


def test_known_variances_leave_the_normal_and_chi_squared() -> None:
    known = LearntCovariance.certain(PHI)
    assert np.isinf(known.freedom).all()
    assert np.isinf(known.denominator)
    assert t_quantile(0.95, math.inf) == pytest.approx(stats.norm.ppf(0.975))
    assert f_tail(5.0, 3, math.inf) == pytest.approx(stats.chi2.sf(5.0, 3))
    assert f_limit(0.95, 3, known.denominator) == pytest.approx(stats.chi2.ppf(0.95, 3))


def test_f_of_one_combination_is_the_square_of_t() -> None:
    one = LearntCovariance.scaled(np.array([[2.0]]), 5)
    assert f_limit(0.95, 1, one.denominator) == pytest.approx(t_quantile(0.95, 5.0) ** 2)
    assert f_tail(2.5**2, 1, 5.0) == pytest.approx(2 * stats.t.sf(2.5, 5))


def test_combinations_of_independent_variances_follow_satterthwaite() -> None:
    """Two sample means with n_1 and n_2 readings: Welch's degrees of freedom of the difference."""
    v, nu = np.array([3.0, 0.5]), np.array([4.0, 9.0])
    slopes = np.array([np.diag([v[0] * math.sqrt(2 / nu[0]), 0.0]),
                       np.diag([0.0, v[1] * math.sqrt(2 / nu[1])])])  # fmt: skip
    both = LearntCovariance(np.diag(v), np.diag(v), slopes)
    np.testing.assert_allclose(both.freedom, nu)
    difference = both.through(np.array([[1.0, -1.0]]))
    welch = v.sum() ** 2 / (v**2 / nu).sum()
    assert difference.freedom[0] == pytest.approx(welch)


def test_the_denominator_does_not_depend_on_the_units_nor_on_the_combinations() -> None:
    slopes = np.array([0.3 * PHI, np.outer([1.0, 0.5, 0.2], [1.0, 0.5, 0.2])])
    learnt = LearntCovariance(PHI, PHI, slopes)
    T = np.array([[1e3, 0.0, 0.0], [0.2, 1e-3, 0.0], [0.1, 0.3, 5.0]])
    assert learnt.through(T).denominator == pytest.approx(float(learnt.denominator), rel=1e-6)


def test_batches_are_treated_one_by_one() -> None:
    learnt = LearntCovariance(PHI, PHI, np.array([0.3 * PHI, np.diag([1.0, 0.2, 0.0])]))
    S = np.random.default_rng(1).normal(size=(5, 2, 3))
    together = learnt.through(S)
    for i, one in enumerate(S):
        alone = learnt.through(one)
        np.testing.assert_allclose(together.freedom[i], alone.freedom)
        assert together.denominator[i] == pytest.approx(float(alone.denominator))


def test_what_has_no_value_has_no_limit_to_fail_at() -> None:
    lost = LearntCovariance.scaled(PHI, 7).through(np.full((2, 1, 3), np.nan))
    assert np.isinf(lost.denominator).all()


def test_a_part_of_a_larger_vector_is_the_product_with_its_selection() -> None:
    learnt, at = LearntCovariance(PHI, PHI, np.array([0.3 * PHI])), np.array([4, 0, 2])
    embedded, product = learnt.within(6, at), learnt.through(np.eye(6)[:, at])
    for name in ("matrix", "plain", "slopes"):
        np.testing.assert_array_equal(getattr(embedded, name), getattr(product, name))


def test_a_size_that_its_prior_alone_knows_gives_no_boundless_interval() -> None:
    """Satterthwaite's half a degree gave +- 165 sds, and 76 m for an arm of 8 poses."""
    variance, slope = np.eye(1), np.full((1, 1, 1), 2.0)  # d ln(variance) of one log-sd
    learnt = LearntCovariance(variance, variance, slope)
    limit = t_quantile(0.95, float(learnt.freedom[0]))
    rng = np.random.default_rng(26500)
    errors = np.exp(rng.standard_normal(100_000)) * rng.standard_normal(100_000)
    assert 0.95 < (np.abs(errors) < limit).mean() < 0.995
    assert limit < 13.0
