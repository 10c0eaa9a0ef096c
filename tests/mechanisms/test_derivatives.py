"""Derivatives of every mechanism against the complex step, at 1,000 random points each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from tests.reference.machines import MACHINES
from tests.reference.plain_tape import complex_step, loop_values

POINTS = 1000


def four_bar(x: Any, p: Any) -> Any:
    """A crank of length a, a coupler b, a rocker c and a frame d; all three angles are read."""
    return (
        p.a * np.cos(x.crank) + p.b * np.cos(x.coupler) - p.c * np.cos(x.rocker + p.offset) - p.d,
        p.a * np.sin(x.crank) + p.b * np.sin(x.coupler) - p.c * np.sin(x.rocker + p.offset),
    )


def draw_wire(x: Any, p: Any) -> Any:
    """The length of a wire from a fixed point to a tip that turns, and a pulley."""
    tip = (p.r * np.cos(x.q), p.r * np.sin(x.q), x.z)
    wire = np.sqrt((tip[0] - p.ax) ** 2 + (tip[1] - p.ay) ** 2 + (tip[2] - p.az) ** 2)
    return (wire + p.pulley * np.arctan2(tip[1] - p.ay, tip[0] - p.ax) - x.length,)


def lengths(**values: float) -> dict[str, tuple[float, str] | Parameter]:
    return {name: (value, "m") for name, value in values.items()}


OWN = {
    "four-bar": Mechanism.from_function(
        four_bar,
        dict.fromkeys(("crank", "coupler", "rocker"), "rad"),
        {
            "a": (0.1, "m"),
            "b": (0.4, "m"),
            "c": (0.3, "m"),
            "d": (0.5, "m"),
            "offset": (0.0, "rad"),
        },
    ),
    "draw wire": Mechanism.from_function(
        draw_wire,
        {"q": "rad", "z": "m", "length": "m"},
        {
            "r": (0.5, "m"),
            "ax": (1.5, "m"),
            "ay": (2.0, "m"),
            "az": (1.0, "m"),
            "pulley": (0.01, "m"),
        },
    ),
}


@pytest.mark.parametrize("name", [*MACHINES, *OWN])
def test_derivatives_meet_the_complex_step_to_1e_8(name: str) -> None:
    mechanism = {**MACHINES, **OWN}[name]
    tape = mechanism.tape
    rng = np.random.default_rng(8)
    x = rng.uniform(-np.pi, np.pi, (len(tape.quantities), POINTS))
    nominal = np.array([parameter.nominal for parameter in mechanism.parameters])
    # ten sets of parameters about the nominal, a hundred poses each
    for part in np.split(np.arange(POINTS), 10):
        p = nominal + rng.normal(0.0, 0.2, len(nominal))
        engine = engine_for(tape, tape.parameters, POINTS)
        found, expected = engine.evaluate(p, x[:, part]), complex_step(tape, x[:, part], p)
        values = loop_values(tape, x[:, part], np.broadcast_to(p[:, None], (len(p), len(part))))
        assert found.f == pytest.approx(values, rel=1e-12, abs=1e-13)
        assert found.by_quantity == pytest.approx(expected.by_quantity, rel=1e-8, abs=1e-13)
        assert found.by_parameter == pytest.approx(expected.by_parameter, rel=1e-8, abs=1e-13)
