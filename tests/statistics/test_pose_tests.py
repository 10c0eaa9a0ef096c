"""Tests of single poses against values found elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import loopcal as lc
from loopcal.estimation.problem.problem import build_problem
from loopcal.statistics.pose_tests import Fitted, try_rows
from tests.reference.simulated import planar_arm

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}


@pytest.mark.parametrize("error", [0.0, 0.05, 0.3])
def test_the_statistic_is_the_least_weighted_square_however_far_a_row_is_from_closing(
    error: float,
) -> None:
    simulated = planar_arm(poses=25)
    problem = build_problem(simulated.truth, simulated.read(SDS), lc.Noise(SDS))
    quantities, n = problem.mechanism.tape.quantities, len(problem.free)
    p = dict(zip(problem.mechanism.parameters.names, problem.start, strict=True))
    readings = problem.readings.copy()
    readings[quantities.index("xP")] += error
    fit = Fitted(problem.start, np.zeros(readings.shape), np.zeros((n, n)), 1.0)
    nothing = np.zeros(readings.shape, dtype=bool)
    t = try_rows(problem, fit, range(25), readings, nothing).tests.t

    def weighted(joints: np.ndarray, row: dict[str, float]) -> np.ndarray:
        first = joints[0] + p["phi20"]
        both = first + joints[1] + p["phi30"]
        found = {
            "xP": p["xA"] + p["l2"] * np.cos(first) + p["l3"] * np.cos(both),
            "yP": p["yA"] + p["l2"] * np.sin(first) + p["l3"] * np.sin(both),
            "phi2": joints[0],
            "phi3": joints[1],
        }
        return np.array([(found[q] - row[q]) / sd for q, sd in SDS.items()])

    for column, statistic in zip(readings.T, t, strict=True):
        row = dict(zip(quantities, column, strict=True))
        start = [row["phi2"], row["phi3"]]
        least = least_squares(weighted, start, args=(row,), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert statistic == pytest.approx(2.0 * least.cost, rel=1e-6, abs=1e-6)
