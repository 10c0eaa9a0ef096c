"""Motions that leave something undetermined are named with what is lost, and held there."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.estimation.cameras.start import start
from loopcal.mechanisms.placement import inverse
from tests.estimation.cameras.truth import shots


@pytest.mark.parametrize(
    ("turns", "held", "code", "lost"),
    [("none", True, "no-rotation", 3), ("axis", False, "parallel-axes", 1)],
)
def test_what_turns_of_the_hand_do_not_show(turns: str, held: bool, code: str, lost: int) -> None:
    true = shots(61, held=held, turns=turns)
    begun = true.start()
    (fact,) = (fact for fact in begun.facts if fact.code == code)
    assert fact.values["lost"] == lost
    assert begun.rms == pytest.approx(0.28, abs=0.03)
    # What is lost stays at zero on the flange: along z alone for turns about z.
    place = (begun.Y[0] if held else inverse(begun.X[0]))[:3, 3]
    np.testing.assert_allclose(place[-lost:], 0.0, atol=1e-5)


def test_free_turns_show_all_and_one_distance_does_not() -> None:
    true = shots(71)
    assert not true.start().facts
    flat = shots(71, turns="none")
    begun = start(flat.corners, None, flat.intrinsics, flat.sizes)
    tilts = {fact.code for fact in begun.facts}
    assert tilts & {"one-distance", "part-of-image"}
