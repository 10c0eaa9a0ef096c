"""Machines whose loops cannot close with these dimensions are told which, and in which pose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import loopcal as lc
from analyses.machines import CASES, STEWART_GOUGH
from loopcal.estimation.problem.alignment import open_loops
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.mechanism import Mechanism
from tests.refusals import refused

NOISE = lc.Noise({"*": 1e-5, "platform_*": np.inf})


def seen(mechanism: Mechanism) -> lc.Dataset:
    poses = lc.random_poses(STEWART_GOUGH, 20, seed=1)
    return lc.simulate(mechanism, poses, noise=NOISE, seed=1).dataset


@pytest.mark.parametrize("run", [lc.calibrate, lc.check])
def test_legs_that_are_too_short_are_named(run: Callable[..., object]) -> None:
    mechanism = CASES["Stewart-Gough, pose"].made()
    short = mechanism.with_nominal({f"leg_{i}_offset": 0.005 for i in range(1, 7)})
    with refused("open-loops", "pose '", "'leg_"):
        run(short, seen(mechanism), noise=NOISE)


def test_loops_that_close_are_not_complained_of() -> None:
    mechanism = CASES["Stewart-Gough, pose"].made()
    assert open_loops(build_problem(mechanism, seen(mechanism), NOISE)) is None


def test_redundant_loops_need_not_agree() -> None:
    """With angles read beside the legs, an error in the geometry leaves loops open."""
    mechanism = CASES["Stewart-Gough, three angles"].made()
    data = seen(mechanism.with_nominal({"a3_x": 0.49}))
    assert open_loops(build_problem(mechanism, data, NOISE)) is None


def test_a_joint_of_the_platform_that_lies_in_one_of_the_base_is_named() -> None:
    mechanism = CASES["Stewart-Gough, point"].made()
    at = {axis: mechanism.parameters[f"a1_{axis}"].nominal for axis in "xyz"}
    coincident = mechanism.with_nominal({f"b1_{axis}": v for axis, v in at.items()})
    still = {q: [0.0] for q in STEWART_GOUGH}
    with refused("outside-domain", "'leg_1'", "pose '1'"):
        lc.simulate(coincident, still, noise=NOISE, seed=1)
