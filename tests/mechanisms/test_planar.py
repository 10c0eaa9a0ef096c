"""The planar two-link arm is the seed's (4.1) and (4.2)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.planar import planar_two_link
from tests.reference.plain_tape import loop_values
from tests.refusals import refused


def test_the_loops_are_the_seeds_equations() -> None:
    arm = planar_two_link()
    assert arm.tape.quantities == ("xP", "yP", "phi2", "phi3")
    assert arm.parameters.names == ("xA", "yA", "l2", "l3", "phi20", "phi30")
    rng = np.random.default_rng(1)
    for x_p, y_p, phi2, phi3, x_a, y_a, l2, l3, phi20, phi30 in rng.uniform(-2, 2, (50, 10)):
        angle_2 = phi2 + phi20
        angle_3 = phi2 + phi20 + phi3 + phi30
        along_x = x_a + l2 * math.cos(angle_2) + l3 * math.cos(angle_3) - x_p
        along_y = y_a + l2 * math.sin(angle_2) + l3 * math.sin(angle_3) - y_p
        found = loop_values(arm.tape, [x_p, y_p, phi2, phi3], [x_a, y_a, l2, l3, phi20, phi30])
        assert found == pytest.approx([along_x, along_y], abs=1e-14)


def test_it_tells_units_outputs_and_how_a_file_describes_it() -> None:
    arm = planar_two_link({"l2": 0.9, "phi20": Parameter("phi20", 0.1, "rad", prior_sd=0.01)})
    assert arm.quantities == {"xP": "m", "yP": "m", "phi2": "rad", "phi3": "rad"}
    assert arm.outputs == ("xP", "yP")
    assert arm.parameters["l2"].nominal == 0.9
    assert arm.parameters["l3"].nominal == 0.6
    assert arm.parameters["phi20"].prior_sd == 0.01
    assert arm.description == {"type": "planar-two-link"}


def test_a_parameter_it_does_not_have_is_refused() -> None:
    with refused("unknown-name", "'phi2'", "'phi20'"):
        planar_two_link({"phi2": 0.1})
