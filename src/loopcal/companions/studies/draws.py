"""One draw of a scenario: readings with noise, calibrated by every method, beside the truth.

The random numbers of a draw depend on the study's seed, the scenario's name and the draw's number
alone. All methods see the same readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.studies.study_file import Scenario, StudyMethod
from loopcal.errors import DomainError, InputError, NoTrustworthyResult
from loopcal.estimation.prediction import predict_outputs, solving
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.statistics.case import Case
from loopcal.statistics.choice import choose

Columns = dict[str, list[str] | NDArray[np.float64]]
SIGMAS = 1.959963984540054
"""Half width of a 95 % interval in sds."""
POINTS = 25
"""Poses of a scenario at which end points are predicted, evenly spread over its list."""
# By chance an error exceeds 6 sds in 2e-9 of the draws, so few needless fits are made.
_SUSPICIOUS, _ELSEWHERE = 6.0, 1e-3
"""Sds of an error above which a fit also starts at the truth, and sds between both ends above which
they are two optima."""


def seed_of(seed: int, scenario: str, draw: int | str) -> int:
    """The seed of a draw (128 bits): equal for equal study seed, scenario name and draw."""
    # A hash, not SeedSequence of positions: scenarios can be added or reordered without new draws.
    digest = sha256(f"{seed}\n{scenario}\n{draw}".encode()).digest()
    return int.from_bytes(digest[:16], "big")


@dataclass(frozen=True)
class _Points:
    """Where end points are predicted: true quantities (k, P), outputs (o, P), constants (c, P)."""

    x: Array
    outputs: Array
    pose_constants: Array


def run_draws(scenario: Scenario, seed: int, draws: Sequence[int]) -> Columns:
    """What the draws of these numbers found: columns with one row per draw and method.

    scenario, method, draw; converged (1 or 0), reason, iterations, chi_squared; error.NAME and
    sd.NAME [SI] of every estimated parameter, true minus estimate; end_point_rms, end_point_max
    [SI] over POINTS poses and end_point_held, the share of their coordinates that lie within
    their 95 % interval; other_optimum (1 or 0): whether a fit from the truth ends elsewhere.

    Raises InputError where a draw cannot be simulated.
    """
    rows: list[dict[str, str | float]] = []
    with one_blas_thread():
        for draw in draws:
            made = _simulated(scenario, seed, draw)
            points = _points(scenario.mechanism, made)
            for method in scenario.methods:
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


def _simulated(scenario: Scenario, seed: int, draw: int) -> Simulation:
    """The readings of a draw; its poses are those of all draws."""
    driven = Dataset.from_arrays(scenario.simulation.driven(seed_of(seed, scenario.name, "poses")))
    draw_seed = seed_of(seed, scenario.name, draw)
    truth = scenario.simulation.machine(scenario.mechanism.parameters, draw_seed)
    return simulate(scenario.mechanism, driven, noise=scenario.noise, seed=draw_seed, truth=truth)


def first_draw(scenario: Scenario, seed: int) -> dict[str, FitResult]:
    """Method -> result for the readings of draw 0: one case behind the distributions.

    A method that cannot evaluate this draw is left out.
    """
    made = _simulated(scenario, seed, 0)
    results = {}
    for method in scenario.methods:
        try:
            results[method.name] = calibrated(method, made)
        except InputError:
            continue
    return results


def _row(
    method: StudyMethod, names: Sequence[str], made: Simulation, points: _Points
) -> dict[str, str | float]:
    """One fit; a parameter that this method holds fixed has an error, and the sd 0."""
    try:
        result = calibrated(method, made)
    except DomainError:
        return _without_result(names, "cannot_evaluate", 0)
    except NoTrustworthyResult:
        return _without_result(names, "sds_not_estimated", 0)
    if not result.status.converged:
        return _without_result(names, result.status.reason, result.status.iterations)
    row: dict[str, str | float] = {
        "reason": result.status.reason,
        "converged": 1.0,
        "iterations": float(result.status.iterations),
        "chi_squared": result.solution.chi_squared,
    }
    row |= {f"error.{name}": made.parameters[name] - result.value[name] for name in names}
    row |= {f"sd.{name}": result.sd[name] or 0.0 for name in names}
    row |= _end_point(method.mechanism, result, points)
    row["other_optimum"] = float(_is_elsewhere(method, made, result))
    return row


def calibrated(method: StudyMethod, made: Simulation) -> FitResult:
    """What `calibrate` makes of the readings of a draw by this method.

    Faults of columns are not sought: the simulation has made the columns. Where the noise alone
    moves readings as far as such a fault would, the search takes fifty times as long as the fit.
    """
    case = Case(method.mechanism, made.dataset, method.noise, method.fit, trusted=True)
    return choose(case).result if method.fit.method.choice else case.calibrated()


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


def _is_elsewhere(method: StudyMethod, made: Simulation, result: FitResult) -> bool:
    """Whether a fit that starts at the truth ends at another optimum.

    Its steps are damped even where the method's own are not: a full first step may leave the truth
    far behind.
    """
    names = result.estimated
    truth = np.array([made.parameters[name] for name in names])
    value = np.array([result.value[name] for name in names])
    sd = np.array([result.sd[name] for name in names], dtype=np.float64)
    rounding = 1e-6 * np.maximum(np.abs(truth), 1.0)
    if not (np.abs(truth - value) > np.maximum(_SUSPICIOUS * sd, rounding)).any():
        return False
    fit = method.fit.changed(
        method=method.fit.method.safe, start=dict(zip(names, truth.tolist(), strict=True))
    )
    try:
        other = calibrated(replace(method, fit=fit), made)
    except (DomainError, NoTrustworthyResult):
        return False
    apart = np.abs([other.value[name] for name in names] - value)
    return bool(other.status.converged and (apart > np.maximum(_ELSEWHERE * sd, rounding)).any())


def _points(mechanism: Mechanism, made: Simulation) -> _Points:
    poses = len(made.dataset)
    at = np.unique(np.linspace(0, poses - 1, min(poses, POINTS)).round().astype(int))
    x = np.array([made.quantities[name][at] for name in mechanism.tape.quantities])
    pose_constants = np.array([made.dataset[name][at] for name in mechanism.tape.pose_constants])
    rows = [mechanism.tape.quantities.index(name) for name in mechanism.outputs]
    return _Points(x, x[rows], pose_constants.reshape(len(mechanism.tape.pose_constants), len(at)))


def _end_point(mechanism: Mechanism, result: FitResult, at: _Points) -> Mapping[str, float]:
    """How far predicted outputs are off at true readings, and whether their intervals hold."""
    units = {mechanism.quantities[name] for name in mechanism.outputs}
    if len(units) != 1:
        return dict.fromkeys(("end_point_rms", "end_point_max", "end_point_held"), math.nan)
    parameters, covariance, o = (
        result.solution.parameters,
        result.covariance,
        len(mechanism.outputs),
    )
    names, patterns = mechanism.tape.quantities, result.problem.patterns
    hidden = {
        names[i] for i in frozenset.intersection(*(frozenset(p.unmeasured) for p in patterns))
    }
    machine = solving(mechanism, hidden)
    closed = predict_outputs(machine, parameters, at.x, at.pose_constants)
    off = closed[:o] - at.outputs
    x = at.x.copy()
    x[[names.index(name) for name in machine.outputs]] = closed
    S = output_sensitivity(
        machine, parameters, result.estimated, x, at.pose_constants
    ).by_parameter[:, :o]
    # Rounding can leave a variance of 0 a little below 0.
    sd = np.sqrt(np.maximum(np.einsum("poi,poi->op", S @ covariance, S), 0.0))
    distance = np.sqrt(np.square(off).sum(axis=0))
    return {
        "end_point_rms": float(np.sqrt(np.mean(np.square(distance)))),
        "end_point_max": float(distance.max()),
        "end_point_held": float(np.mean(np.abs(off) <= SIGMAS * sd)),
    }
