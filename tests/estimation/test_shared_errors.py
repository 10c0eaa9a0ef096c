"""Errors that targets share are detected at the level stated, and outlier tests allow for them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from loopcal.estimation.dependence import dependence
from loopcal.estimation.dependence.seen import Seen
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.statistics.pose_tests import Fitted, independent, pose_tests

TARGETS = ("r1", "r2", "r3")


def residuals(rng: np.random.Generator, poses: int, common: float) -> np.ndarray:
    """(poses, 9): three points each, whose errors share this part of their variance."""
    own = rng.standard_normal((poses, 3, 3))
    shared = rng.standard_normal((poses, 1, 3))
    return (np.sqrt(1.0 - common) * own + np.sqrt(common) * shared).reshape(poses, 9)


def judged(monkeypatch: pytest.MonkeyPatch, E: np.ndarray) -> Any:
    families = [SimpleNamespace(name=n, readings=(n,)) for n in TARGETS]
    ones = np.broadcast_to(np.eye(3), (len(E), 3, 3))

    def seen(problem: Any, equations: Any, root: Any, readings: tuple[str]) -> Seen:
        first = 3 * TARGETS.index(readings[0])
        return Seen(E[:, first : first + 3], np.zeros((len(E), 3, 0)), ones)

    monkeypatch.setattr(dependence, "instruments", lambda problem: families)
    monkeypatch.setattr(dependence, "seen", seen)
    problem: Any = None
    return dependence._shared(problem, (), np.zeros((0, 0)))


def test_independent_targets_are_called_dependent_at_the_level_stated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(8)
    p = np.array([judged(monkeypatch, residuals(rng, 40, 0.0)).p_value for _ in range(400)])
    assert 0.02 <= (p < 0.05).mean() <= 0.08


def test_shared_errors_are_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(9)
    found = [judged(monkeypatch, residuals(rng, 80, 0.5)) for _ in range(20)]
    assert all(one.p_value < 1e-6 for one in found)
    assert 0.4 < np.mean([one.correlation for one in found]) < 0.75
    assert judged(monkeypatch, residuals(rng, 17, 0.5)) is None  # too few poses


def test_outlier_tests_hold_their_level_where_targets_share_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(10)
    N = 150
    rates: dict[str, list[float]] = {"white": [], "turned": []}
    problem: Any = SimpleNamespace(
        readings=np.zeros((9, N)), uncertainty=SimpleNamespace(sd=np.ones((9, N)))
    )
    problem.where_closed = problem
    for _ in range(40):
        E = residuals(rng, N, 0.8)
        X = np.broadcast_to(np.eye(9), (N, 9, 9))  # each equation has a reading of its own
        block = PoseEquations(np.arange(N), E, np.zeros((N, 9, 1)), X)
        monkeypatch.setattr(
            "loopcal.statistics.pose_tests.pose_equations", lambda *_, block=block, **__: (block,)
        )
        plain = Fitted(np.zeros(1), np.zeros((9, N)), np.zeros((1, 1)), 1.0)
        turned = Fitted(
            plain.parameters,
            plain.corrections,
            plain.covariance,
            1.0,
            alike=independent((block,), np.ones(N, dtype=bool)),
        )
        none = np.zeros(N, dtype=bool)
        for name, fit in (("white", plain), ("turned", turned)):
            rates[name].append((pose_tests(problem, fit, none).p_pose < 0.01).mean())
    assert np.mean(rates["white"]) > 0.03
    assert np.mean(rates["turned"]) < 0.02
