"""The search for variances: few evaluations, and steps that stay above their bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar, nnls

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import MixedFit
from loopcal.estimation.noise.search import Bounds, _least_above_zero, search


def test_squares_above_zero_are_those_of_scipy() -> None:
    rng = np.random.default_rng(7)
    for _ in range(500):
        n = int(rng.integers(2, 10))
        A = rng.standard_normal((n, n)) * np.exp(2.0 * rng.standard_normal((n, 1)))
        b = rng.standard_normal(n)
        u, expected = _least_above_zero(A, b), nnls(A, b)[0]
        assert (u >= 0.0).all()
        np.testing.assert_allclose(A @ u, A @ expected, atol=1e-9 * float(np.linalg.norm(b)))


def test_nothing_is_above_zero_where_everything_leads_below() -> None:
    assert not _least_above_zero(np.eye(3), -np.ones(3)).any()


@pytest.mark.parametrize("load", [1e-3, 1e-2, 1e-1])
def test_few_evaluations_where_the_information_is_far_from_the_curvature(load: float) -> None:
    # Readings that load the component by little err by much: it cannot be all that they lack.
    loads, squares = np.repeat([1.0, load], [60, 20]), np.repeat([0.1, 1.0], [60, 20])
    calls = 0

    def likelihood(x: Array, information: Array | None) -> MixedFit:
        nonlocal calls
        calls += 1
        V = 1e-2 + float(x[0]) * loads
        share = loads / V
        score = 0.5 * (share * (squares / V - 1.0)).sum()
        fresh = information is None
        expected = (
            np.array([[0.5 * np.square(share).sum()]]) if information is None else information
        )
        criterion = float((np.log(V) + squares / V).sum())
        return MixedFit(x, criterion, np.array([score]), expected, fresh)

    bounds = Bounds(np.zeros(1), np.ones(1, dtype=bool))
    end = search(likelihood, likelihood(np.ones(1), None), bounds, enough=1e-6)
    needed = calls
    best = minimize_scalar(
        lambda log: likelihood(np.exp([log]), None).criterion, bracket=(0.0, 3.0), tol=1e-12
    )
    assert end.converged
    assert end.at.criterion - end.promised == pytest.approx(best.fun, abs=1e-4)
    assert needed <= 20  # with the information alone 29, 49 and more than 200
