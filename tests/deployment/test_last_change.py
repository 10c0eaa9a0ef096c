"""Poses as they would be read after the last change."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.deployment.exporting import after_last_change
from loopcal.mechanisms.effects.drift import Shift
from loopcal.mechanisms.effects.effect import with_effects
from loopcal.mechanisms.model_error import with_model_error
from tests.deployment.test_exporting import RANGES, arm


@pytest.mark.parametrize("disturbed", [False, True])
def test_points_before_a_change_are_read_as_after_it(disturbed: bool) -> None:
    """Whether or not the model has an error of its own, which nobody reads."""
    slipped = with_effects(arm(), [Shift(("tool_x",), at=(20.0,))])
    slipped = slipped.with_nominal({"tool_x_from20": 2e-3})
    joints = lc.random_poses(RANGES, 30, seed=1)

    def seen(numbers: object) -> lc.Dataset:
        given = joints | {"pose": np.asarray(numbers, dtype=float)}
        return lc.simulate(slipped, given, noise={"*": 0.0}, seed=1).dataset

    machine = with_model_error(slipped) if disturbed else slipped
    found = after_last_change(machine, seen(np.arange(30)))
    after = seen(np.full(30, 29.0))
    assert any(abs(found[q] - seen(np.arange(30))[q]).max() > 1e-4 for q in "xyz")
    for q in "xyz":
        assert found[q] == pytest.approx(after[q], abs=1e-9)
