"""A machine whose readings say nothing of its size is never shrunk."""

from __future__ import annotations

import pytest

import loopcal as lc
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
