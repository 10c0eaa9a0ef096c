"""Poses in blocks: as few as their derivatives ask, and the same numbers in any of them."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.noise.linear_model import fit, linear_model
from loopcal.estimation.problem import problem as module
from loopcal.estimation.problem.problem import VALUES, Problem, build_problem
from loopcal.estimation.solve.sweep import Sweeper
from tests.reference.simulated import MA1400_RANGES, ma1400

POSES = 1500
SDS = {f"theta_{i}": 2e-5 for i in range(1, 7)} | dict.fromkeys("xyz", 5e-5)


def structured() -> Problem:
    """An arm with hundreds of columns of a model error, and its readings."""
    arm, noise = ma1400(2).truth, lc.Noise(SDS)
    low, high = 0.6 * MA1400_RANGES.T
    joints = np.random.default_rng(1).uniform(low, high, (POSES, 6))
    poses = {f"theta_{i + 1}": joints[:, i] for i in range(6)}
    data = lc.simulate(arm, poses, noise=noise, seed=1).dataset
    return build_problem(lc.structured(arm, discrepancy=True), data, noise)


def test_derivatives_by_parameters_count_for_the_size_of_a_block() -> None:
    problem = structured()
    tape = problem.mechanism.tape
    each = len(tape.loops) * (len(tape.quantities) + len(problem.free))
    assert len(problem.free) > 200
    assert problem.block * each <= VALUES
    assert len(list(problem.blocks())) > 1


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_many_blocks_say_what_one_says(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOOPCAL_ENGINE", engine)
    none = np.zeros((9, POSES))
    by_size = {}
    for values in (VALUES, 100 * VALUES):
        monkeypatch.setattr(module, "VALUES", values)
        problem = structured()
        names = problem.mechanism.tape.quantities
        model = linear_model(problem, problem.start, none, [[names.index(n)] for n in "xyz"])
        swept = Sweeper(problem).sweep(problem.start, none).data.total
        by_size[len(model.blocks)] = fit(model, np.ones(3)), swept
    (several, some), (one, total) = by_size.values()
    assert [*by_size][1] == 1
    np.testing.assert_allclose(some, total, rtol=1e-9, atol=1e-12 * np.abs(total).max())
    assert several is not None
    assert one is not None
    assert several.criterion == pytest.approx(one.criterion, rel=1e-10)
    np.testing.assert_allclose(several.score, one.score, rtol=1e-7)
    np.testing.assert_allclose(several.information, one.information, rtol=1e-7)
