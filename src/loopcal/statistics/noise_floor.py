"""The noise floor: how far computed and measured outputs are apart with the right parameters.

With exact parameters the outputs computed from noisy readings still miss the measured ones, by

    E |d|^2 = trace(S Sigma_x S^T + Sigma_y),   S = dy/dx.

No calibration can do better on readings that are not corrected. Where nothing but the outputs says
where a pose is, as of a board that is held before a camera, the pose follows their noise: with U
the derivatives of the outputs by it and W their weights, d loses U (U^T W U)^-1 U^T W d.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.accuracy import main_unit
from loopcal.estimation.noise.learning import typical_sd
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.mechanisms.outputs import POLAR, Seen, cartesian, seen_outputs

# A complex step subtracts nothing, so it can be so small (Squire and Trapp 1998).
_STEP = 1e-20


def noise_floor(result: FitResult) -> float | None:
    """Root mean square distance [unit of the accuracy] that the noise of the readings causes.

    None where no sds are known, or nothing is computed.
    """
    unknown = result.fit.solver.exact and result.inherited is None
    if unknown or not result.mechanism.outputs:
        return None
    return _floor(result)


def excess(result: FitResult) -> float | None:
    """The errors at the outputs over those that the stated sds of all sensors cause, by the error
    beside the sensors that a fit learnt; None where it learnt none, or sds of sensors as well."""
    if result.fit.solver.exact or result.estimate is None:
        return None
    problem, aside = result.problem, set(result.mechanism.disturbances)
    learnt = {i for one in result.estimate.stated for i in one.quantities}
    sds = {i: typical_sd(problem, i) for i in learnt}
    names = problem.mechanism.tape.quantities
    model_sds = [sd for i, sd in sds.items() if names[i] in aside and sd is not None]
    if not model_sds or any(names[i] not in aside for i, sd in sds.items() if sd is not None):
        return None
    floor = noise_floor(result)
    return math.sqrt(1.0 + sum(sd**2 for sd in model_sds) / floor**2) if floor else None


def _floor(result: FitResult) -> float | None:
    mechanism, problem = result.calibrated, result.problem
    quantities = mechanism.tape.quantities
    unit = main_unit(result.deviations(result.differences_after))
    sds = np.array(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    # The floor is that of the sensors: the model's own error is no noise of a reading.
    sds[[quantities.index(q) for q in mechanism.disturbances]] = 0.0
    values = np.array([p.nominal for p in mechanism.parameters])
    outputs, parts = [quantities.index(q) for q in mechanism.outputs], []
    for pattern, poses in _blocks(problem):
        x = problem.readings[:, poses] + result.solution.corrections[:, poses]
        constants, sd = problem.pose_constants[:, poses], sds[:, poses]
        hidden = [i for i in pattern.unmeasured if i not in outputs]
        loose = len(outputs) + len(hidden) > len(mechanism.tape.loops)
        also = () if loose else pattern.unmeasured
        S = output_sensitivity(mechanism, values, problem.names, x, constants, also).by_reading
        S[:, np.arange(len(outputs)), outputs] = 1.0  # measured less computed, apart from the rest
        spread = S * np.where(np.isfinite(sd), sd, 0.0).T[:, None, :]
        if loose:
            spread = _followed(spread, S[:, :, hidden], sd[outputs].T)
        for seen in seen_outputs(mechanism):
            read = [quantities.index(q) for q in seen.position or seen.turns]
            if (seen.unit if seen.position else "rad") == unit and set(read) <= set(outputs):
                rows = [outputs.index(i) for i in read]
                parts.append(_squares(seen, spread[:, rows], x[read], sd[read]))
    squares = np.concatenate(parts) if parts else np.empty(0)
    squares = squares[np.isfinite(squares)]
    return math.sqrt(float(squares.mean())) if squares.size else None


def _blocks(problem: Problem) -> Iterator[tuple[Pattern, NDArray[np.intp]]]:
    """Patterns with some of their poses: slopes by all readings are large for images."""
    everything = np.arange(len(problem.poses))
    for pattern in problem.patterns:
        poses = everything[pattern.poses]
        for begin in range(0, len(poses), problem.most):
            yield pattern, poses[begin : begin + problem.most]


def _followed(spread: Array, U: Array, sd: Array) -> Array:
    """What (N, o, k) leaves where poses with the derivatives U (N, o, u) follow outputs with these
    sds (N, o); NaN where the pose is lost."""
    lost = np.asarray((np.isnan(spread).any(axis=2) & np.isfinite(sd)).any(axis=1))
    w = np.where(np.isfinite(sd) & (sd > 0.0), 1.0 / np.where(sd > 0.0, sd, 1.0), 0.0)[:, :, None]
    U, spread = np.nan_to_num(U), np.nan_to_num(spread)
    left = spread - U @ (np.linalg.pinv(w * U) @ (w * spread))
    return np.where(lost[:, None, None], np.nan, left)


def _squares(seen: Seen, spread: Array, x: Array, sd: Array) -> Array:
    """(N,) expected squared distance of what one instrument sees; inf where it reads nothing.

    spread: (N, d, k) of its readings x (d, N) by one sd of each; sd: (d, N).
    """
    both = _turned(x) @ spread if seen.form in POLAR else spread
    both = np.where(np.isfinite(sd).T[:, :, None], both, np.inf)
    squares = np.square(both).sum(axis=2)
    if seen.image:  # of the points that were seen
        there = np.isfinite(squares)
        total, count = np.where(there, squares, 0.0).sum(axis=1), there.sum(axis=1)
        return np.where(count > 0, 2.0 * total / np.maximum(count, 1), np.inf)
    return np.asarray(squares.sum(axis=1), dtype=np.float64)


def _turned(readings: Array) -> Array:
    """(N, d, d) derivatives of Cartesian points by range and angles (d, N), by a complex step."""
    columns = []
    for row in range(len(readings)):
        moved = readings.astype(complex)
        moved[row] += 1j * _STEP
        columns.append(cartesian(moved).imag / _STEP)
    return np.array(columns).transpose(2, 1, 0)
