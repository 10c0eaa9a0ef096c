"""The choice of poses: equal to brute force, and never better than its bound."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import minimize

from loopcal.planning.information import Information
from loopcal.planning.plan import certificate
from loopcal.planning.search import Criterion, Search, choose, criterion_value, inverse

CRITERIA: tuple[Criterion, ...] = ("I", "G", "D", "A")


def pool(candidates: int, seed: int, k: int = 4, r: int = 2, nuisance: int = 1) -> Information:
    """Random candidates, in coordinates whose last ones are a nuisance."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((candidates, r, k)) * np.exp(rng.standard_normal((candidates, 1, 1)))
    tests = rng.standard_normal((6, 3, k))
    tests[..., k - nuisance :] = 0.0
    interest = np.arange(k) < k - nuisance
    return Information(
        rows,
        1e-3 * np.eye(k),
        tests,
        np.eye(k),
        np.eye(k)[:, k - nuisance :],
        interest,
        1e-9,
    )


def brute(draws: list[Information], number: int, criterion: Criterion) -> float:
    every = combinations(range(len(draws[0].rows)), number)
    return min(
        float(np.mean([criterion_value(d, d.of(list(c)), criterion) for d in draws])) for c in every
    )


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_choice_is_that_of_brute_force(criterion: Criterion) -> None:
    for seed in range(5):
        draws = [pool(11, seed)]
        found = choose(draws, 4, criterion)
        assert found.value == pytest.approx(brute(draws, 4, criterion), rel=1e-9), seed


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_choice_over_draws_is_that_of_brute_force(criterion: Criterion) -> None:
    draws = [pool(10, 1), pool(10, 2)]
    found = choose(draws, 4, criterion)
    assert found.value == pytest.approx(brute(draws, 4, criterion), rel=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_gains_are_what_the_criterion_falls_by(criterion: Criterion) -> None:
    """Also after poses came and went: updates are the inverse."""
    draw = pool(9, 3)
    search = Search([draw], criterion)
    for i in (4, 1, 7, 2):
        search.add(i)
    search.remove(1)
    gains, before = search.gains(), search.value()
    for i in (0, 1, 3, 5, 6, 8):
        after = criterion_value(draw, draw.of([4, 7, 2, i]), criterion)
        assert gains[i] == pytest.approx(before - after, rel=1e-8)
    assert np.isneginf(gains[[4, 7, 2]]).all()
    np.testing.assert_allclose(
        search.systems[0].C, inverse(draw.of([4, 7, 2])), rtol=1e-9, atol=1e-12
    )


def relaxed(draw: Information, number: int, criterion: Criterion) -> float:
    """The continuous optimum by another optimiser; of G over the bound t of all variances."""
    N = len(draw.rows)

    def value(w: np.ndarray) -> float:
        total = draw.start + np.einsum("i,irk,irl->kl", w, draw.rows, draw.rows)
        return criterion_value(draw, total, criterion)

    if criterion != "G":
        found = minimize(
            value,
            np.full(N, number / N),
            bounds=[(0.0, 1.0)] * N,
            constraints={"type": "eq", "fun": lambda w: w.sum() - number},
            method="SLSQP",
            options={"maxiter": 500, "ftol": 1e-12},
        )
        return float(found.fun)

    def each(w: np.ndarray) -> np.ndarray:
        total = draw.start + np.einsum("i,irk,irl->kl", w[:-1], draw.rows, draw.rows)
        return np.einsum("tok,kl,tol->t", draw.tests, inverse(total), draw.tests)

    start = np.full(N, number / N)
    found = minimize(
        lambda w: w[-1],
        np.append(start, value(start)),
        bounds=[(0.0, 1.0)] * N + [(0.0, None)],
        constraints=[
            {"type": "eq", "fun": lambda w: w[:-1].sum() - number},
            {"type": "ineq", "fun": lambda w: w[-1] - each(w)},
        ],
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    return float(found.fun)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_bound_is_the_continuous_optimum(criterion: Criterion) -> None:
    """Within 1 % and from below; of D within 0.01 per parameter, its logarithm."""
    draw = pool(14, 10)
    found = certificate([draw], choose([draw], 5, criterion).poses, criterion)
    best = relaxed(draw, 5, criterion)
    if criterion == "D":
        assert best - 0.03 < found.bound <= best + 1e-4
    else:
        assert 0.99 * best < found.bound <= best * (1.0 + 1e-4)
    assert found.bound <= found.value
    assert 0.0 < found.efficiency <= 1.0


@pytest.mark.parametrize("criterion", ["I", "D"])
def test_a_few_steps_come_within_a_hundredth_of_the_best_bound(
    criterion: Criterion, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = pool(2000, 3, k=10, r=3)
    poses = choose([draw], 20, criterion).poses
    monkeypatch.setattr("loopcal.planning.plan._CLOSE", 0.0)
    found = []
    for steps in (30, 2000):
        monkeypatch.setattr("loopcal.planning.plan._FEWEST", steps)
        monkeypatch.setattr("loopcal.planning.plan._MOST", steps)
        found.append(certificate([draw], poses, criterion).efficiency)
    assert found[1] - 0.01 < found[0] <= found[1] + 1e-9


def test_nothing_chosen_twice() -> None:
    found = choose([pool(12, 5)], 12, "I")
    assert sorted(found.poses) == list(range(12))
    whole = certificate([pool(12, 5)], found.poses, "I")
    assert whole.efficiency == pytest.approx(1.0)
