"""A machine that holds one point while its joints move, as in a test of rotary axes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.estimation.faults.search import HELD, column_faults
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.machine import assemble

Array = NDArray[np.float64]
BALL = np.array([0.08, 0.03, 0.06])
ROTARY = (0.0, 0.0, -0.45)
JOINTS = [
    ScrewJoint("X", axis=(-1, 0, 0), kind="prismatic"),
    ScrewJoint("Y", axis=(0, -1, 0), kind="prismatic"),
    ScrewJoint("Z", axis=(0, 0, -1), kind="prismatic"),
    ScrewJoint("A", axis=(1, 0, 0), point=ROTARY),
    ScrewJoint("C", axis=(0, 0, 1), point=ROTARY),
]


def held(seed: int) -> dict[str, Array]:
    """Slides follow the ball as drawn; rotary axes 0.1 mm off move it at the nest."""
    draw, N = np.random.default_rng(seed), 60
    A, C = draw.uniform(-1.5, 0.5, N), draw.uniform(-3.0, 3.0, N)

    def at(off: Array) -> Array:
        x, y = np.cos(C) * BALL[0] - np.sin(C) * BALL[1], np.sin(C) * BALL[0] + np.cos(C) * BALL[1]
        x, y, z = x + off[0], y + off[1], BALL[2] + off[2] - ROTARY[2]
        return np.array([x, np.cos(A) * y - np.sin(A) * z, np.sin(A) * y + np.cos(A) * z])

    slides = at(np.zeros(3))
    seen = at(1e-4 * draw.standard_normal(3)) - slides + 2e-6 * draw.standard_normal((3, N))
    shown = dict(zip("XYZ", slides + np.array([[0], [0], [ROTARY[2]]]), strict=True))
    return shown | {"A": A, "C": C} | dict(zip("xyz", seen, strict=True))


@pytest.mark.parametrize("station", ["base", None])
def test_a_held_point_is_no_fault_of_the_file(station: str | None) -> None:
    """Its readings spread by the errors of the machine alone, which columns exchanged do not
    explain; an instrument that may stand anywhere is not placed by them."""
    machine = assemble(
        exponentials(JOINTS), [lc.instruments.point(station=station, target="ball")]
    ).with_nominal(dict(zip(("ball_x", "ball_y", "ball_z"), BALL.tolist(), strict=True)))
    data = lc.Dataset.from_arrays(held(1))
    noise = lc.Noise({"[XYZ]": 1e-6, "[AC]": 1e-5, "[xyz]": 2e-6})
    faults = column_faults(build_problem(machine, data, noise), suspected=station is not None)
    assert [one.code for one in faults] == ([HELD] if station else [])
