"""Tests of single poses against values found elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import least_squares

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.problem.pose_equations import Beside, PoseEquations
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.statistics import causes
from loopcal.statistics.causes import Suspect, _Guess
from loopcal.statistics.outlier_search import Search
from loopcal.statistics.pose_tests import Fitted, _shared, try_rows
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


def test_an_image_that_tests_nothing_of_a_column_has_no_freedom_there() -> None:
    """Rounding leaves -1e-16 there, by which nothing may be divided."""
    random = np.random.default_rng(61001)
    X = random.normal(size=(2, 8, 6))
    beside = Beside(8, np.array([8, 8]), np.zeros((2, 6)))
    block = PoseEquations(np.arange(2), random.normal(size=(2, 8)), np.zeros((2, 8, 1)), X, beside)
    turns = np.linalg.qr(random.normal(size=(2, 8, 8)))[0]
    lost = np.zeros((2, 8))
    lost[0] = 1.0  # the parameters take up all of the first image
    along = np.einsum("brk,br->kb", X, block.E) * np.array([1e-9, 1.0])
    chi, freedom = _shared(block, np.swapaxes(turns, 1, 2) @ X, lost, along)
    assert freedom.tolist() == [0, 6]
    P = X[1] @ np.linalg.solve(X[1].T @ X[1], X[1].T)
    assert chi == pytest.approx([0.0, block.E[1] @ P @ block.E[1]])


@pytest.mark.parametrize(("reach", "verified"), [(0.1, True), (1.2, False)])
def test_a_cause_is_verified_only_where_the_parameters_say_where_the_row_belongs(
    reach: float, verified: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Far from all poses any row fits: one that was read by chance, and one that is right."""
    arm, noise = lc.motoman_ma1400(), lc.Noise({"theta_*": 5e-5, "xyz": 3e-5})
    centre = np.array([0.2, 0.7, -0.6, 1.7, 0.3, 1.5])

    def around(poses: int, half: float) -> lc.Dataset:
        q = centre[:, None] + half * np.random.default_rng(poses).uniform(-1.0, 1.0, (6, poses))
        where = {f"theta_{i}": row for i, row in enumerate(q, 1)}
        return lc.simulate(arm, where, noise=noise, seed=poses).dataset

    result = calibrate(arm, around(60, 0.15), noise=noise)
    search = Search(result, 0.01, "auto")
    fit, _, _ = search.run()
    rows = around(3, reach).readings
    read = np.array([rows[name] for name in search.problem.mechanism.tape.quantities]).T

    def guesses(_problem: Problem, _data: lc.Dataset, suspect: Suspect) -> Iterator[_Guess]:
        yield _Guess("it was read so", None, read[suspect.pose])

    monkeypatch.setattr(causes, "_guesses", guesses)
    suspects = [Suspect(pose, 100.0, 3, {}) for pose in range(3)]
    made = causes.find_causes(search.problem, result.dataset, fit, suspects)
    assert [one is not None for one in made] == [verified] * 3
