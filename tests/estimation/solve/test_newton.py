"""Stubborn loops are closed pose by pose, whatever the other poses of a block need."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.newton import close_by_newton
from loopcal.estimation.solve.sweep import Sweeper


def test_a_pose_closes_alone_as_it_does_among_others() -> None:
    """Some poses are a few sds from closing, others stretched or out of reach."""
    arm, rng = lc.planar_two_link(), np.random.default_rng(4)
    poses = {q: rng.uniform(-3.0, 3.0, 40) for q in ("phi2", "phi3")}
    noise = lc.Noise({"?P": 1e-4, "phi?": 1e-3})
    made = lc.simulate(arm, poses, noise=noise, seed=1).dataset
    far = {q: np.array(made[q]) for q in made.quantities}
    for q in ("xP", "yP"):
        far[q] = far[q] * np.repeat([1.0, 1.05, 1.5, 3.0], 10)
    problem = build_problem(arm, lc.Dataset.from_arrays(far), noise)
    sweeper = Sweeper(problem)
    ((pattern, block),) = sweeper.blocks(problem.start)
    tape = problem.tape(pattern)
    together = close_by_newton(tape, block, 1e-9)
    assert not together.open.all()
    for i in range(block.count):
        alone = close_by_newton(tape, block.of(np.array([i])), 1e-9)
        assert alone.open[0] == together.open[i]
        if not alone.open[0]:
            here = together.corrections[:, [i]]
            assert alone.corrections == pytest.approx(here, rel=1e-9, abs=1e-12)
