"""Motions that leave something undetermined are named with what is lost, and held there."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.cameras.start import start
from tests.estimation.cameras.truth import shots


@pytest.mark.parametrize(
    ("turns", "code", "lost"), [("none", "no-rotation", 3), ("axis", "parallel-axes", 1)]
)
@pytest.mark.parametrize("held", [True, False])
def test_what_turns_of_the_hand_do_not_show(turns: str, code: str, lost: int, held: bool) -> None:
    true = shots(61, held=held, turns=turns)
    begun = true.start()
    (fact,) = (fact for fact in begun.facts if fact.code == code)
    assert fact.values["lost"] == lost
    assert begun.rms == pytest.approx(0.28, abs=0.03)
    # What is lost stays at zero on the flange: along z alone for turns about z.
    place = (begun.T_flange_board or begun.T_flange_camera).popitem()[1][:3, 3]
    np.testing.assert_allclose(place[-lost:], 0.0, atol=1e-5)


def test_free_turns_show_all() -> None:
    codes = {fact.code for fact in shots(67).start().facts}
    assert not codes & {"no-rotation", "parallel-axes", "pure-turns"}


def test_boards_parallel_to_the_image_without_a_robot() -> None:
    true = shots(71, turns="none")
    begun = start(true.corners, None, true.intrinsics, true.sizes)
    assert "one-distance" in {fact.code for fact in begun.facts}
