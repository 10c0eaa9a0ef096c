"""A four-bar whose coupler no sensor reads, and the same four-bar with the coupler eliminated."""

from __future__ import annotations

from typing import Any

import numpy as np

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from tests.reference.random_cases import four_bar
from tests.reference.simulated import Simulated

ANGLES = {"crank": "rad", "rocker": "rad"}


def passive() -> Simulated:
    """Crank and rocker are read; the coupler's angle is a quantity without a sensor.

    The coupler has no zero of its own: with nothing read there, it would say nothing.
    """
    measured = four_bar()

    def loops(x: Any, p: Any) -> Any:
        crank, rocker = x.crank + p.crank0, x.rocker + p.rocker0
        return (
            p.a * np.cos(crank) + p.b * np.cos(x.coupler) - p.c * np.cos(rocker) - p.d,
            p.a * np.sin(crank) + p.b * np.sin(x.coupler) - p.c * np.sin(rocker),
        )

    truth = Mechanism.from_function(
        loops, {**ANGLES, "coupler": "rad"}, _parameters(measured), name="passive coupler"
    )
    exact = {**measured.exact, "coupler": measured.exact["coupler"] + measured.values["coupler0"]}
    return Simulated(truth, {q: exact[q] for q in truth.quantities})


def eliminated() -> Simulated:
    """The coupler eliminated by hand: the distance of its two ends is its length."""
    measured = four_bar()

    def loop(x: Any, p: Any) -> Any:
        crank, rocker = x.crank + p.crank0, x.rocker + p.rocker0
        along = p.c * np.cos(rocker) + p.d - p.a * np.cos(crank)
        across = p.c * np.sin(rocker) - p.a * np.sin(crank)
        return (np.hypot(along, across) - p.b,)

    truth = Mechanism.from_function(loop, ANGLES, _parameters(measured), name="no coupler")
    return Simulated(truth, {q: measured.exact[q] for q in truth.quantities})


def _parameters(measured: Simulated) -> dict[str, Parameter]:
    return {p.name: p for p in measured.truth.parameters if p.name != "coupler0"}
