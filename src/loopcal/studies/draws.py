"""One draw of a scenario: readings with noise, calibrated by every method, beside the truth.

The random numbers of a draw depend on the study's seed, the scenario's name and the draw's number
alone, and all methods see the same readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import DomainError
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.solve.reduction import undetermined
from loopcal.estimation.solve.reweighted import solve_reweighted
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.seed_iteration import iterate_undamped
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import solve
from loopcal.files.study.study_file import Scenario, StudyMethod
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.statistics.sensitivity import output_sensitivity

Array = NDArray[np.float64]
Columns = dict[str, list[str] | NDArray[np.float64]]
SIGMAS = 1.959963984540054
"""Half width of a 95 % interval in sds."""
POINTS = 25
"""Poses of a scenario at which end points are predicted, evenly spread over its list."""
_SUSPICIOUS, _ELSEWHERE = 6.0, 1e-3
"""An error of so many sds asks for a fit that starts at the truth; ending so many sds apart from
it is another optimum."""


def seed_of(seed: int, scenario: str, draw: int | str) -> int:
    """The seed of a draw (128 bits): equal for equal study seed, scenario name and draw."""
    digest = sha256(f"{seed}\n{scenario}\n{draw}".encode()).digest()
    return int.from_bytes(digest[:16], "big")


@dataclass(frozen=True)
class _Points:
    """Where end points are predicted: true quantities (k, P), outputs (o, P), constants (c, P)."""

    x: Array
    outputs: Array
    known: Array


def run_draws(
    scenario: Scenario, seed: int, draws: Sequence[int], methods: Sequence[int] | None = None
) -> Columns:
    """What the draws of these numbers found: columns with one row per draw and method.

    scenario, method, draw; converged (1 or 0), reason, iterations, chi_squared; error.NAME and
    sd.NAME [SI] of every estimated parameter, true minus estimate; end_point_rms, end_point_max
    [SI] over POINTS poses and end_point_held, the share of their coordinates that lie within
    their 95 % interval; other_optimum (1 or 0): whether a fit from the truth ends elsewhere.

    Raises InputError where a draw cannot be simulated.
    """
    driven = Dataset.from_arrays(scenario.simulation.driven(seed_of(seed, scenario.name, "poses")))
    rows: list[dict[str, str | float]] = []
    chosen = range(len(scenario.methods)) if methods is None else methods
    with one_blas_thread():
        for draw in draws:
            own = seed_of(seed, scenario.name, draw)
            truth = scenario.simulation.machine(scenario.mechanism.parameters, own)
            made = simulate(scenario.mechanism, driven, noise=scenario.noise, seed=own, truth=truth)
            points = _points(scenario.mechanism, made)
            for i in chosen:
                method = scenario.methods[i]
                head: dict[str, str | float] = {
                    "scenario": scenario.name,
                    "method": method.name,
                    "draw": float(draw),
                }
                rows.append(head | _row(method, scenario.estimated, made, points))
    return {
        name: [str(row[name]) for row in rows]
        if isinstance(rows[0][name], str)
        else np.array([row[name] for row in rows], dtype=np.float64)
        for name in rows[0]
    }


def _row(
    method: StudyMethod, names: Sequence[str], made: Simulation, points: _Points
) -> dict[str, str | float]:
    """One fit; a parameter that this method holds fixed has an error, and the sd 0."""
    problem = build_problem(
        method.mechanism,
        made.dataset,
        None if method.method == "least-squares" else method.noise,
    )
    try:
        found = _solved(method, problem)
    except DomainError:
        return _without_result(names, "cannot_evaluate", 0)
    if not found.status.converged:
        return _without_result(names, found.status.reason, found.status.iterations)
    truth = np.array([made.parameters[name] for name in method.mechanism.parameters.names])
    covariance = _covariance(method, problem, found)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    for combination in undetermined(found.spectrum, problem.names):
        sd[[problem.names.index(name) for name in combination]] = np.inf
    errors = dict(zip(method.mechanism.parameters.names, truth - found.parameters, strict=True))
    sds = dict(zip(problem.names, sd.tolist(), strict=True))
    row: dict[str, str | float] = {
        "reason": found.status.reason,
        "converged": 1.0,
        "iterations": float(found.status.iterations),
        "chi_squared": found.chi_squared,
    }
    row |= {f"error.{name}": float(errors[name]) for name in names}
    row |= {f"sd.{name}": sds.get(name, 0.0) for name in names}
    row |= _end_point(method.mechanism, problem.names, found.parameters, covariance, points)
    row["other_optimum"] = float(_is_elsewhere(method, problem, found, truth, sd))
    return row


def _without_result(names: Sequence[str], reason: str, iterations: int) -> dict[str, str | float]:
    row: dict[str, str | float] = {
        "reason": reason,
        "converged": 0.0,
        "iterations": float(iterations),
        "chi_squared": math.nan,
    }
    row |= {f"{kind}.{name}": math.nan for kind in ("error", "sd") for name in names}
    row |= dict.fromkeys(("end_point_rms", "end_point_max", "end_point_held"), math.nan)
    return row | {"other_optimum": 0.0}


def _solved(method: StudyMethod, problem: Problem) -> Solution:
    if method.method == "reweighted":
        return solve_reweighted(problem)
    if method.method == "implicit-loop-undamped":
        return iterate_undamped(problem)
    return solve(problem, exact=method.method == "least-squares")


def _covariance(method: StudyMethod, problem: Problem, found: Solution) -> Array:
    """That of `calibrate`: least squares takes its scale from the loop values."""
    covariance = found.spectrum.covariance()
    if method.method != "least-squares":
        return covariance
    freedom = problem.equations - found.spectrum.rank
    return covariance * (found.chi_squared / freedom if freedom > 0 else math.inf)


def _is_elsewhere(
    method: StudyMethod, problem: Problem, found: Solution, truth: Array, sd: Array
) -> bool:
    """Whether a fit that starts at the truth ends at another optimum.

    That fit is damped for the undamped method too, whose first step may leave the truth far behind.
    """
    off = np.abs(truth - found.parameters)[problem.free]
    rounding = 1e-6 * np.maximum(np.abs(truth[problem.free]), 1.0)
    if not (off > np.maximum(_SUSPICIOUS * sd, rounding)).any():
        return False
    try:
        if method.method == "implicit-loop-undamped":
            method = replace(method, method="implicit-loop")
        other = _solved(method, replace(problem, start=truth))
    except DomainError:
        return False
    apart = np.abs(other.parameters - found.parameters)[problem.free]
    return bool(other.status.converged and (apart > np.maximum(_ELSEWHERE * sd, rounding)).any())


def _points(mechanism: Mechanism, made: Simulation) -> _Points:
    poses = len(made.dataset)
    at = np.unique(np.linspace(0, poses - 1, min(poses, POINTS)).round().astype(int))
    x = np.array([made.quantities[name][at] for name in mechanism.tape.quantities])
    known = np.array([made.dataset[name][at] for name in mechanism.tape.known])
    rows = [mechanism.tape.quantities.index(name) for name in mechanism.outputs]
    return _Points(x, x[rows], known.reshape(len(mechanism.tape.known), len(at)))


def _end_point(
    mechanism: Mechanism, names: Sequence[str], parameters: Array, covariance: Array, at: _Points
) -> Mapping[str, float]:
    """How far predicted outputs are off at true readings, and whether their intervals hold."""
    units = {mechanism.quantities[name] for name in mechanism.outputs}
    if len(units) != 1:
        return dict.fromkeys(("end_point_rms", "end_point_max", "end_point_held"), math.nan)
    computed = predict_outputs(mechanism, parameters, at.x, at.known)
    off = computed - at.outputs
    x = at.x.copy()
    x[[mechanism.tape.quantities.index(name) for name in mechanism.outputs]] = computed
    S = output_sensitivity(mechanism, parameters, names, x, at.known).by_parameter
    sd = np.sqrt(np.maximum(np.einsum("poi,ij,poj->op", S, covariance, S), 0.0))
    distance = np.sqrt(np.square(off).sum(axis=0))
    return {
        "end_point_rms": float(np.sqrt(np.mean(np.square(distance)))),
        "end_point_max": float(distance.max()),
        "end_point_held": float(np.mean(np.abs(off) <= SIGMAS * sd)),
    }
