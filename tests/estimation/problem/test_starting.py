"""Unread quantities are found from home, and from elsewhere where home misleads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.machines import STEWART_GOUGH
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.choice import AVAILABLE, ENGINES
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr

SDS = {"*": 5e-5, "leg_*": 1e-5, "platform_*": np.inf}
POSITION = ["platform_x", "platform_y", "platform_z"]
TURNS = ["platform_rz", "platform_ry", "platform_rx"]
Array = NDArray[np.float64]


def found_at_start(mechanism: lc.Mechanism, made: lc.Simulation) -> dict[str, Array]:
    problem = build_problem(mechanism, made.dataset, lc.Noise(SDS))
    x = problem.readings + start_corrections(Sweeper(problem), problem.start)
    return dict(zip(mechanism.tape.quantities, x, strict=True))


def apart(a: Mapping[str, Array], b: Mapping[str, Array]) -> tuple[float, float]:
    """Largest distance [m] and turn [rad] between the platforms of two solutions."""
    shift = np.array([a[q] - b[q] for q in POSITION])
    turns = [Rotation.from_euler("ZYX", np.array([x[q] for q in TURNS]).T) for x in (a, b)]
    turned = (turns[0].inv() * turns[1]).magnitude()
    return float(np.linalg.norm(shift, axis=0).max()), float(turned.max())


@pytest.mark.parametrize(
    "home",
    [
        {},
        {"platform_rz": 3.0},
        {"platform_ry": -1.4, "platform_rx": 2.5},
        {"platform_x": 3.0, "platform_z": 0.2},
    ],
)
def test_the_platform_is_found_in_every_pose_whatever_its_home(home: dict[str, float]) -> None:
    """With 1 mm of error in the geometry it is found to 20 mm and 50 mrad."""
    mechanism = assemble(stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"], home=home))
    usual = assemble(stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"]))
    draw = np.random.default_rng(1)
    truth = {
        n: usual.parameters[n].nominal + 1e-3 * draw.standard_normal()
        for n in usual.parameters.free
    }
    noise = lc.Noise(SDS)
    poses = lc.random_poses(STEWART_GOUGH, 200, seed=2)
    made = lc.simulate(usual, poses, noise=noise, seed=3, truth=truth)
    distance, turn = apart(found_at_start(mechanism, made), made.quantities)
    assert distance < 0.02
    assert turn < 0.05


def test_one_stray_pose_is_sought_elsewhere() -> None:
    """A hundred poses near home and one upside down: the sample does not hold it."""
    mechanism = assemble(stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"]))
    noise = lc.Noise(SDS)
    poses = lc.random_poses(STEWART_GOUGH, 101, seed=2)
    turned = {q: v.copy() for q, v in poses.items()}
    turned["platform_rz"][50] += 2.4
    made = lc.simulate(mechanism, turned, noise=noise, seed=3)
    distance, turn = apart(found_at_start(mechanism, made), made.quantities)
    assert distance < 1e-3
    assert turn < 1e-3


@pytest.mark.parametrize("engine", ENGINES if AVAILABLE else ["numpy"])
def test_loops_of_exact_readings_hold_as_well_as_points(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points beside drives that count as exact: the platform stays in the form of its home."""
    monkeypatch.setenv("LOOPCAL_ENGINE", engine)
    station = {"base_x": 0.05, "base_y": -0.03, "base_rz": 0.9, "tool_x": 0.02, "tool_y": 0.01}
    machine = assemble(three_rrr(), [lc.instruments.point(dimension=2)])
    draw, parameters = np.random.default_rng(1), machine.parameters
    links = [n for n in parameters.names if n[0] in "abpd" and not n.startswith("base")]
    truth = {n: parameters[n].nominal + 4e-4 * draw.standard_normal() for n in links} | station
    where = {"platform_x": (-0.045, 0.045), "platform_y": (-0.045, 0.045)}
    poses = lc.random_poses(where | {"platform_rz": (-0.3, 0.3)}, 200, seed=2)
    noise = lc.Noise({"theta_*": 0.0, "platform_*": np.inf, "[xy]": 1e-4})
    made = lc.simulate(machine, poses, noise=noise, seed=3, truth=truth)
    problem = build_problem(machine.with_nominal(station), made.dataset, noise)
    x = problem.readings + start_corrections(Sweeper(problem), problem.start)
    turn = x[machine.tape.quantities.index("platform_rz")]
    assert np.abs(np.sin(0.5 * (turn - made.quantities["platform_rz"]))).max() < 0.02
