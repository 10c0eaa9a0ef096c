"""A machine whose readings say nothing of its size is never shrunk."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.problem.size import refuse_without_length
from loopcal.mechanisms.mechanism import Mechanism
from tests.reference.random_cases import four_bar
from tests.refusals import refused

LENGTHS = ("a", "b", "c", "d")
SDS = dict.fromkeys(("crank", "coupler", "rocker"), 1e-3)


def held(*names: str) -> Mechanism:
    truth = four_bar().truth
    free = truth.parameters.with_fixed(LENGTHS, fixed=False)
    return truth.with_parameters(free.with_fixed(names))


@pytest.mark.parametrize("method", ["least-squares", "reweighted"])
def test_angles_alone_never_shrink_a_machine(method: str) -> None:
    data = four_bar().read(SDS, seed=1)
    with refused("unknown-size", "all readings are angles"):
        lc.calibrate(held(), data, noise=lc.Noise(SDS), method=method)
    known = lc.calibrate(held("d"), data, noise=lc.Noise(SDS), method=method)
    assert known.value["a"] == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize("method", ["auto", "implicit-loop"])
def test_the_implicit_loop_leaves_the_size_where_it_was(method: str) -> None:
    data = four_bar().read(SDS, seed=1)
    found = lc.calibrate(held(), data, noise=lc.Noise(SDS), method=method)
    assert sum(found.value[n] for n in LENGTHS) == pytest.approx(1.8, rel=1e-3)
    assert "'a', 'b', 'c' and 'd' cannot be distinguished" in " ".join(found.warnings)


def test_a_point_beside_a_lens_does_not_hide_that_a_radius_is_known() -> None:
    """Turned at random, an arm passes beside its camera, where pixels have no bound."""

    def loops(x: Any, p: Any) -> list[Any]:
        X = p.a * np.cos(x.q1) + p.b * np.cos(x.q1 + x.q2)
        Y = p.a * np.sin(x.q1) + p.b * np.sin(x.q1 + x.q2)
        return [p.f * Y / X - x.u, np.sqrt((X - p.c) ** 2 + Y * Y) - p.r - x.gap]

    quantities = {"q1": "rad", "q2": "rad", "u": "px", "gap": "m"}
    lengths = {"a": (0.5, "m"), "b": (0.4, "m"), "c": (0.7, "m"), "r": (0.1, "m")}
    made = lc.Mechanism.from_function(loops, quantities, {**lengths, "f": (8000.0, "px")})
    machine = replace(made, implied={"gap": 0.0})
    draw = np.random.default_rng(2)
    readings = np.zeros((4, 2000))
    readings[:2] = draw.uniform(-2.5, 2.5, (2, 2000))
    sd = np.full((4, 1), 1e-4)
    none = np.zeros((0, 2000))
    with refused("unknown-size", "gap read 0"):
        refuse_without_length(machine, readings, none, sd)
    parameters = machine.parameters.with_fixed(("a", "r"))
    refuse_without_length(machine.with_parameters(parameters), readings, none, sd)
