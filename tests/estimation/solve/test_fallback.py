"""After a fit that did not converge, other starts are tried, and the status says which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.solve.fallback import solve_or_fall_back
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import solve
from loopcal.measurements.noise import Noise
from tests.reference.simulated import planar_arm

SDS = {"xP": 1e-3, "yP": 1e-3, "phi2": 1e-3, "phi3": 1e-3}


def problem() -> Problem:
    simulated = planar_arm(20)
    return build_problem(simulated.off(0.05, 0.1), simulated.read(SDS, seed=1), Noise(SDS))


def test_a_fit_that_converges_is_left_alone() -> None:
    found = solve_or_fall_back(problem(), solve)
    assert found.status.converged
    assert found.status.note == ""
    assert found.parameters.tolist() == solve(problem()).parameters.tolist()


def test_least_squares_is_the_next_start() -> None:
    begun = problem()

    def only_near(problem: Problem) -> Solution:
        found = solve(problem)
        if (problem.start == begun.start).all():
            return replace(found, status=replace(found.status, converged=False, reason="stalled"))
        return found

    found = solve_or_fall_back(begun, only_near)
    assert found.status.converged
    assert found.status.note == (
        "Started from least squares: from the stated start it ended stalled."
    )
    assert found.status.note in found.status.message
    assert found.chi_squared == pytest.approx(solve(begun).chi_squared, rel=1e-9)


def test_what_was_tried_in_vain_is_said() -> None:
    found = solve_or_fall_back(problem(), lambda p: solve(p, max_iterations=0))
    assert found.status.reason == "max_iterations"
    assert found.status.message.endswith(
        "Starting from least squares, the iteration of the thesis, the best of several starts "
        "did not help."
    )


def test_a_machine_assembled_the_other_way_round_is_found() -> None:
    """Every parameter off by up to half a metre or two radians: 12 starts, one optimum each.

    The first file is searched for faults too, which costs more than the fit.
    """
    reached = 0
    for seed in range(12):
        simulated = planar_arm(20, seed=seed)
        data = simulated.read(SDS, seed=seed)
        best = calibrate(simulated.truth, data, noise=Noise(SDS), start="nominal")
        off = simulated.off(0.5, 2.0, seed=seed)
        result = calibrate(off, data, noise=Noise(SDS), start="nominal", trusted=seed > 0)
        assert best.chi_squared is not None
        assert result.chi_squared is not None
        if result.status.converged:
            reached += result.chi_squared.value <= best.chi_squared.value * (1 + 1e-6)
            assert result.status.note in (*result.warnings, "")
    assert reached >= 11


def test_a_misfit_is_tried_from_elsewhere() -> None:
    """Every parameter off by up to 0.3 m or 1 rad, sds over three decades: 40 starts."""
    from_elsewhere = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        sds = {name: 0.1 * float(10 ** rng.uniform(-3, 0)) for name in SDS}
        simulated = planar_arm(20, seed=seed)
        data, noise = simulated.read(sds, seed=seed), Noise(sds)
        best = calibrate(simulated.truth, data, noise=noise, start="nominal")
        off = simulated.off(0.3, 1.0, seed=seed)
        result = calibrate(off, data, noise=noise, start="nominal", trusted=True)
        assert result.status.converged
        assert result.solution.chi_squared <= best.solution.chi_squared * (1 + 1e-6)
        if "chi-squared is" in result.status.note:
            from_elsewhere += 1
            assert result.status.note in result.warnings
    assert from_elsewhere >= 2


def test_a_misfit_at_the_best_optimum_costs_one_fit() -> None:
    """Sds stated a hundred times too small: the fit stands, and is not repeated."""
    simulated = planar_arm(20)
    small = Noise({name: 1e-2 * sd for name, sd in SDS.items()})
    begun = build_problem(simulated.off(0.05, 0.1), simulated.read(SDS, seed=1), small)
    fits = []

    def counted(problem: Problem) -> Solution:
        fits.append(problem)
        return solve(problem)

    found = solve_or_fall_back(begun, counted, judged=True)
    assert found.chi_squared > 100 * found.equations
    assert found.status.note == ""
    assert len(fits) == 1
