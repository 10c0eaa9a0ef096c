"""Constants of each pose that carry no error."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.mechanisms.effects.backlash import Backlash
from loopcal.mechanisms.effects.effect import with_effects
from tests.reference.simulated import planar_arm
from tests.refusals import refused

ARM = planar_arm(40)
BENT = with_effects(ARM.truth, [Backlash(("phi3",))])
DATA = ARM.read({"xP": 1e-4, "yP": 1e-4}, seed=1)
NOISE = lc.Noise({"?P": 1e-4, "phi?": 0.0})
DIRECTIONS = np.where(np.arange(40) % 2, 1.0, -1.0)


def test_a_direction_of_approach_is_one_of_three() -> None:
    wrong = np.where(np.arange(40) == 7, 2.0, DIRECTIONS)
    with refused("invalid-value", "'phi3_direction'", "pose '8'", "1 of 40"):
        lc.calibrate(
            BENT, DATA.with_readings({"phi3_direction": wrong}), noise=NOISE, method="implicit-loop"
        )


@pytest.mark.parametrize("taken_out", [False, True])
def test_directions_may_be_zero_where_the_play_was_taken_out(taken_out: bool) -> None:
    some = np.where(taken_out & (np.arange(40) < 5), 0.0, DIRECTIONS)
    found = lc.calibrate(
        BENT, DATA.with_readings({"phi3_direction": some}), noise=NOISE, method="implicit-loop"
    )
    assert found.status.converged
