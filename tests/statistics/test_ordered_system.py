"""The ordered equations of a fit: what a step explains, beside columns that come and go."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.statistics import ordered_system as ordered
from loopcal.statistics.estimated import Estimated
from loopcal.statistics.ordered_system import Fitted, ordered_system
from tests.statistics.test_change_points import fitted, joints, read

TARGET = ("x6B", "y6B", "z6B")


@pytest.fixture(scope="module")
def fit() -> Fitted:
    return ordered_system(fitted(read(joints(40, 1), 1))).fitted()


def target(fit: Fitted, at: int) -> np.ndarray:
    """The columns of a target that moves at a position."""
    columns = fit.system.columns(TARGET)
    return (np.arange(len(columns)) >= at)[:, None, None] * columns


def squares(fit: Fitted) -> float:
    """What the fit makes least."""
    nominal = fit.pull / np.where(fit.precision > 0.0, fit.precision, 1.0)
    return float(np.square(fit.left).sum() + fit.precision @ np.square(fit.z - nominal))


def test_the_gain_from_every_pose_on_is_that_of_a_step_there(fit: Fitted) -> None:
    gains, ranks = fit.gains(fit.system.columns(TARGET))
    for at in (5, 17, 33):
        alone = fit.step(target(fit, at))
        assert gains[at] == pytest.approx(alone.gain, rel=1e-9)
        assert ranks[at] == alone.rank


def test_a_gain_is_what_the_squares_fall_by_with_everything_fitted_anew(fit: Fitted) -> None:
    columns = target(fit, 17)
    with_step = fit.beside(columns)
    assert squares(fit) - squares(with_step) == pytest.approx(fit.step(columns).gain, rel=1e-6)
    np.testing.assert_allclose(with_step.z[:3], fit.step(columns).size, rtol=1e-6, atol=1e-12)


def test_columns_that_join_and_leave_again_change_nothing(fit: Fitted) -> None:
    again = fit.beside(target(fit, 17)).beside(target(fit, 9)).without(3, 3).without(0, 3)
    np.testing.assert_allclose(again.z, fit.z, rtol=1e-9)
    np.testing.assert_allclose(again.left, fit.left, rtol=0.0, atol=1e-9)


def test_a_scatter_with_the_step_is_turned_into_that_without() -> None:
    """Of n rows alike, with s left of squares by the step and g more without: n g / (s + g)."""
    left, gain, rows = 80.0, 20.0, 100.0
    with_step = gain / (left / rows)
    step = Estimated(np.sqrt([with_step, 0.0, 0.0]), np.eye(3))
    assert step.before(rows) == pytest.approx(gain / ((left + gain) / rows))


def test_the_poses_may_be_taken_in_parts(fit: Fitted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ordered, "_PART", 7)
    parts = fit.system.fitted()
    np.testing.assert_allclose(parts.left, fit.left, rtol=0.0, atol=1e-7)
    for columns in (fit.system.columns(TARGET), fit.system.columns(["theta_3"])):
        gains, ranks = fit.gains(columns)
        by_part, ranks_by_part = parts.gains(columns)
        assert (ranks == ranks_by_part).all()
        np.testing.assert_allclose(by_part, gains, rtol=1e-5, atol=1e-6)
