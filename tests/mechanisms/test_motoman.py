"""The MA1400 is the seed's chain, and its drawing's classical Denavit-Hartenberg chain."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from loopcal.mechanisms.planar import motoman_ma1400
from tests.reference import frames
from tests.reference.machines import MA1400_TOOL
from tests.reference.plain_tape import loop_values

SEED_NAMES = [
    *("x0", "y0", "phix0", "phiy0"),
    *("x1", "z1", "phix1", "phiz1"),
    *("x2", "z2", "phix2", "phiz2"),
    *("y3", "z3", "phiy3", "phiz3"),
    *("x4", "z4", "phix4", "phiz4"),
    *("x5", "y5", "phix5", "phiy5"),
    *("x6B", "y6B", "z6B"),
]
# a, d, alpha, offset of S, L, U, R, B, T
DH = [
    (0.150, 1.4159, -pi / 2, 0.0),
    (0.614, 0.0, pi, -pi / 2),
    (0.200, 0.0, -pi / 2, 0.0),
    (0.0, -0.640, pi / 2, 0.0),
    (0.030, 0.0, pi / 2, -pi / 2),
    (0.0, 0.200, 0.0, 0.0),
]


def test_it_has_exactly_the_seeds_27_parameters() -> None:
    arm = motoman_ma1400()
    assert list(arm.parameters.names) == SEED_NAMES
    assert len(arm.parameters) == 27
    assert arm.tape.quantities == (*(f"theta_{i}" for i in range(1, 7)), "x", "y", "z")
    assert arm.outputs == ("x", "y", "z")
    assert {p.unit for p in arm.parameters if "phi" in p.name} == {"rad"}
    assert {p.unit for p in arm.parameters if "phi" not in p.name} == {"m"}


def test_at_its_nominal_it_equals_the_drawings_dh_chain_to_1e_12() -> None:
    arm = motoman_ma1400(MA1400_TOOL)
    p = [parameter.nominal for parameter in arm.parameters]
    worst = 0.0
    for joints in np.random.default_rng(6).uniform(-pi, pi, (1000, 6)):
        T = np.eye(4)
        for (a, d, alpha, offset), q in zip(DH, joints, strict=True):
            T = T @ frames.dh(a, d, alpha, q + offset)
        # the reflector of the left arm behind T; T's own 0.2 m is in the last row
        point = frames.point_of(T, [0.05, 0.0, 0.25])
        closed = loop_values(arm.tape, [*joints, *point], p)
        worst = max(worst, float(abs(closed).max()))
    assert worst <= 1e-12


def test_it_is_the_seeds_product_of_matrices() -> None:
    arm = motoman_ma1400()
    rng = np.random.default_rng(7)
    for row in rng.uniform(-1, 1, (100, 33)):
        theta, p = row[:6], dict(zip(SEED_NAMES, row[6:], strict=True))
        T = np.eye(4)
        for i, (axis, sign) in enumerate(zip("zyyxyz", (1, 1, -1, -1, -1, -1), strict=True)):
            numbers = [p[name] for name in SEED_NAMES[4 * i : 4 * i + 4]]
            T = T @ frames.transition(axis, numbers, frames.turn(axis, sign * theta[i]))
        point = frames.point_of(T, [p["x6B"], p["y6B"], p["z6B"]])
        closed = loop_values(arm.tape, [*theta, *point], list(p.values()))
        assert abs(closed).max() <= 1e-14


def test_values_given_replace_the_drawings() -> None:
    arm = motoman_ma1400({"z2": 0.615, "phix0": 0.1})
    assert arm.parameters["z2"].nominal == pytest.approx(0.615)
    assert arm.parameters["x4"].nominal == pytest.approx(0.640)
    assert arm.parameters["phix0"].nominal == pytest.approx(0.1)
