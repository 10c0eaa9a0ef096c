"""Small grids of alike poses have curved valleys: where MINPACK converges, so does the solver."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from analyses.instruments import SIX, SLIDES, Z
from loopcal.estimation.problem.problem import Problem, Weighting, taken
from loopcal.estimation.solve import solver
from loopcal.estimation.solve.reweighted import solve_reweighted
from loopcal.estimation.solve.solver import solve
from loopcal.estimation.steps import started
from loopcal.expressions.engine import engine_for
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.redundancy import fix_redundant
from loopcal.simulation.simulate import simulate
from tests.estimation.test_real_data import left_arm, measured

Array = NDArray[np.float64]
NOISE = Noise({"theta_*": 5e-5, "xyz": 1e-5})


def minpack(problem: Problem) -> OptimizeResult:
    """Levenberg and Marquardt's method as in MINPACK (Moré 1978), on the same residuals."""
    engine = engine_for(problem.mechanism.tape, problem.names, problem.count, ())

    def values(z: Array, what: str) -> Array:
        p = problem.unknowns.moved(problem.start, z - problem.start[problem.free])
        found = engine.evaluate(p, problem.readings, problem.pose_constants)
        rows = found.f if what == "f" else found.by_parameter
        return np.asarray(rows.reshape(*rows.shape[:-2], -1).T.copy())

    return least_squares(
        lambda z: values(z, "f"),
        problem.start[problem.free],
        lambda z: values(z, "J"),
        method="lm",
        x_scale="jac",
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-15,
    )


def converges_as_minpack(problem: Problem) -> float:
    """Hold the law; how many evaluations it took, as a share of MINPACK's."""
    theirs, ours = minpack(problem), solve(problem.weighted(Weighting.ALIKE))
    if theirs.status > 0:
        assert ours.status.converged, ours.status
        assert ours.chi_squared <= 2.0 * theirs.cost * (1 + 1e-9)
    return ours.status.evaluations / (theirs.nfev + theirs.njev)


@pytest.fixture(scope="module")
def grid(shared_data: Callable[[str], Path]) -> Problem:
    """The left arm's 6 x 6 x 6 poses, placed."""
    data = measured(shared_data("motoman_ma1400_leica/left_arm_grid.csv"))
    return started(left_arm(), data, NOISE, "align")


def levels(problem: Problem) -> Array:
    """Which of the six levels of the grid each pose is on, (3, N)."""
    xyz = problem.readings[[problem.mechanism.tape.quantities.index(a) for a in "xyz"]]
    gaps = np.sort(xyz, axis=1)
    jumps = np.diff(gaps, axis=1) > 0.05 * np.ptp(gaps, axis=1, keepdims=True)
    edges = [row[:-1][jump] for row, jump in zip(gaps, jumps, strict=True)]
    return np.array([np.searchsorted(e + 1e-9, row) for e, row in zip(edges, xyz, strict=True)])


CUTS: dict[str, Callable[[Array], Any]] = {
    "all": lambda at: at[0] >= 0,
    "upper half": lambda at: at[2] >= 3,
    "lowest plane": lambda at: at[2] == 0,
    "one plane": lambda at: at[1] == 2,
    "two planes": lambda at: np.isin(at[2], [0, 5]),
    "corner": lambda at: (at >= 3).all(axis=0),
    "other corner": lambda at: (at[0] < 3) & (at[1:] >= 3).all(axis=0),
    "every second": lambda at: (at % 2 == 1).all(axis=0),
    "another every second": lambda at: (at[0] % 2 == 0) & (at[1:] % 2 == 1).all(axis=0),
}


@pytest.mark.parametrize("cut", CUTS)
def test_parts_of_a_small_grid(grid: Problem, cut: str) -> None:
    part = taken(grid, np.flatnonzero(CUTS[cut](levels(grid))))
    converges_as_minpack(part)
    assert solve_reweighted(part).status.converged
    assert solve(part).status.converged


SCARA = (
    LinkJoint("q1", "revolute", (0, 0, 0.4), axis=Z),
    LinkJoint("q2", "revolute", (0.35, 0, 0), axis=Z),
    LinkJoint("q3", "prismatic", (0.3, 0, 0.05), (0.02, 0, 0), axis=Z),
    LinkJoint("q4", "revolute", (0, 0, -0.1), (0, 0.02, 0), axis=Z),
)
ARMS = {"six axes": SIX, "SCARA": SCARA, "slides": SLIDES}


def small(arm: str, seed: int) -> Problem:
    """About 60 poses in a box of 0.3 rad or m, read with noise, from up to 5 mm and 5 mrad off."""
    made = assemble(joint_chain(ARMS[arm]), [point()], {"tool_x": 0.05, "tool_z": 0.12})
    nominal = fix_redundant(made)
    rng = np.random.default_rng(seed)
    joints = [q for q in nominal.quantities if q not in nominal.outputs]
    steps = rng.integers(0, 4, (len(joints), 60)) / 3.0
    poses = {q: 0.3 * row - 0.1 for q, row in zip(joints, steps, strict=True)}
    free = nominal.parameters.free
    truth = {n: nominal.parameters[n].nominal + rng.uniform(-5e-3, 5e-3) for n in free}
    noise = Noise({**dict.fromkeys(joints, 5e-5), "xyz": 1e-5})
    read = simulate(nominal, Dataset.from_arrays(poses), noise=noise, seed=seed, truth=truth)
    return started(nominal, read.dataset, noise, "nominal")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("arm", ARMS)
def test_small_grids_of_other_arms_with_flat_priors(arm: str, seed: int) -> None:
    converges_as_minpack(small(arm, seed))


def curved(bend: float, sd: float = 1.0) -> Problem:
    """A valley along y = bend x^2 / 2, a hundred times as steep as it falls (Rosenbrock 1960)."""
    machine = Mechanism.from_function(
        lambda q, p: [q.w * (p.y - 0.5 * bend * p.x * p.x) - q.a, p.x - q.b],
        {"w": "1", "a": "1", "b": "1"},
        {"x": (-1.0, "1"), "y": (0.5 * bend, "1")},
    )
    data = Dataset.from_arrays({"w": [100.0] * 4, "a": [0.0] * 4, "b": [0.9, 1.1, 0.95, 1.05]})
    return started(machine, data, Noise({"w": 0.0, "a": sd, "b": sd}), "nominal")


@pytest.mark.parametrize("bend", [1.0, 30.0, 1000.0])
def test_steps_follow_a_curved_valley(bend: float) -> None:
    found = solve(curved(bend=bend))
    assert found.status.converged
    assert found.parameters == pytest.approx([1.0, 0.5 * bend], rel=1e-9)
    assert found.status.iterations <= 12


def test_a_fit_without_progress_ends_long_before_its_iterations_run_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = small("six axes", 0)
    began = solve(problem.weighted(Weighting.ALIKE), max_iterations=0)
    assert solve(problem.weighted(Weighting.ALIKE)).status.converged
    monkeypatch.setattr(solver, "_PATIENCE", 2)
    monkeypatch.setattr(solver, "_PROGRESS", 1.0)  # whatever the merit gains is none
    ended = solve(problem.weighted(Weighting.ALIKE))
    assert ended.status.reason == "stalled"
    assert ended.status.iterations <= 4
    assert ended.chi_squared <= began.chi_squared


@pytest.mark.parametrize(("sd", "reason"), [(1e-3, "stalled"), (1.0, "converged")])
def test_a_gross_misfit_that_hardly_falls_ends_soon(
    sd: float, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readings 70 sds off are of another machine; of a file at fault 1,000 steps took minutes."""
    monkeypatch.setattr(solver, "_PATIENCE", 2)
    monkeypatch.setattr(solver, "_GROSS", 1.0)  # whatever the merit falls by is little
    assert solve(curved(30.0, sd)).status.reason == reason


def test_a_fit_that_gains_nothing_beside_its_sds_ends_and_can_be_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = curved(bend=30.0)
    end = solve(problem)
    monkeypatch.setattr(solver, "_PATIENCE", 1)
    monkeypatch.setattr(solver, "_CREEPING", 1e9)  # whatever it gains is little
    monkeypatch.setattr(solver, "_LEFT", 10.0)
    ended = solve(problem)
    assert (ended.status.reason, ended.status.converged) == ("crept", True)
    assert ended.status.iterations <= end.status.iterations
    # what the next step would gain bounds how far the end is from the optimum
    variance = end.chi_squared / (8 - 2)
    assert 0.0 <= ended.chi_squared - end.chi_squared <= 10.0 * variance
