"""Both engines where a solve is small, and where quantities are unmeasured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ours
from measuring import DisagreementError, Times, in_turns
from numpy.typing import NDArray
from problems import six_axis

import loopcal as lc
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import solve
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.station import Target

Array = NDArray[np.float64]
DRAWS, DRAWN_POSES, STEWART_POSES = 1_000, 300, 100_000
MONTE_CARLO_DEMANDED, ELIMINATION_DEMANDED = 3.0, 4.0
AGREED = 1e-6
"""Largest difference between the engines' parameters, in sds."""
DRIVEN = {
    "platform_x": (-0.1, 0.1),
    "platform_y": (-0.1, 0.1),
    "platform_z": (0.6, 0.8),
    "platform_rz": (-0.4, 0.4),
    "platform_ry": (-0.3, 0.3),
    "platform_rx": (-0.3, 0.3),
}


@dataclass(frozen=True)
class Engines:
    """One problem on both engines."""

    problem: str
    times: dict[str, Times]
    demanded: float

    @property
    def ratio(self) -> float:
        """How many times longer NumPy takes."""
        return self.times["numpy"].median / self.times["compiled"].median


@dataclass(frozen=True)
class Solved:
    """A problem and where its fit ended."""

    problem: Problem
    found: Solution


def _solved(problem: Problem) -> Solved:
    return Solved(problem, solve(problem))


def monte_carlo(draws: int = DRAWS) -> Engines:
    """Calibrations of the six-axis arm from the same poses, each with noise of its own."""
    problem, rng = six_axis(DRAWN_POSES), np.random.default_rng(2)
    rows, sds = np.vstack([problem.joints, problem.points]), problem.sds[:, None]
    names = problem.quantities
    drawn = [
        lc.Dataset.from_arrays(
            dict(zip(names, rows + sds * rng.standard_normal(rows.shape), strict=True))
        )
        for _ in range(draws)
    ]
    noise = lc.Noise(dict(zip(names, (2**0.5 * problem.sds).tolist(), strict=True)))

    def run() -> list[Solved]:
        return [_solved(build_problem(problem.mechanism, data, noise)) for data in drawn]

    title = f"Monte Carlo: {draws:,} calibrations, six-axis, {DRAWN_POSES} poses"
    return _compared(title, run, MONTE_CARLO_DEMANDED, rounds=3)


def elimination(poses: int = STEWART_POSES) -> Engines:
    """A Stewart-Gough platform whose pose is seen by an instrument; no joint reads it."""
    machine = assemble(stewart_gough(), [pose(station=None, target=Target(()))])
    rng = np.random.default_rng(3)
    truth = {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in machine.parameters}
    truth = {name: truth[name] for name in machine.parameters.free}
    sds = {q: 1e-5 if unit == "m" else 5e-5 for q, unit in machine.quantities.items()}
    unread = {q: np.inf for q in machine.quantities if q.startswith("platform_")}
    noise = lc.Noise(sds | unread)
    driven = lc.random_poses(DRIVEN, poses, seed=4)
    data = lc.simulate(machine, driven, noise=noise, seed=5, truth=truth).dataset

    def run() -> list[Solved]:
        return [_solved(build_problem(machine, data, noise))]

    title = f"Stewart-Gough, {poses:,} poses, six quantities unmeasured"
    return _compared(title, run, ELIMINATION_DEMANDED, rounds=3)


def _compared(title: str, run: Callable[[], list[Solved]], demanded: float, rounds: int) -> Engines:
    programs = {name: ours.on_engine(name, run) for name in ("compiled", "numpy")}
    ours_, theirs = (program() for program in programs.values())
    worst = max(_apart(a, b) for a, b in zip(ours_, theirs, strict=True))
    if not worst <= AGREED:
        raise DisagreementError(f"{title}: the engines differ by {worst:.2g} sds")
    return Engines(title, in_turns(programs, rounds=rounds), demanded)


def _apart(a: Solved, b: Solved) -> float:
    """The largest difference of two fits' parameters, in sds."""
    if not (a.found.status.converged and b.found.status.converged):
        return np.inf
    free = b.problem.free
    sds = np.sqrt(np.diag(b.found.spectrum.covariance()))
    return float((np.abs(a.found.parameters - b.found.parameters)[free] / sds).max())
