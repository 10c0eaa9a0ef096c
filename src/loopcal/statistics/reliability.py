"""What single readings can hide, by Baarda's theory of reliability (1968).

The test statistic w of a reading that is wrong by d is N(d sqrt(P), 1), P = x^T W x (`redundancy`).
At the level alpha it finds the error with the stated power where |d| sqrt(P) is at least

    delta = z(1 - alpha / 2) + z(power),   so the minimal detectable bias is   delta / sqrt(P).

That is the internal reliability. An error of this size that stays in the data moves the parameters
by -C D^T x d; what this does to the predicted outputs is the external reliability.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from loopcal.arrays import Array
from loopcal.document.change_points import Reliability, SensorReliability
from loopcal.document.plain import finite
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.redundancy import UNCONTROLLED, redundancy
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.mechanisms.outputs import output_groups
from loopcal.presentation.shown import brief

# Baarda (1968): with these the noncentrality is 4.13.
ALPHA, POWER = 0.001, 0.8
# As in `region`: an rms of 400 is sure to 2.5 %.
_MOST = 400
"""Poses over which the effect on predictions is averaged."""


@dataclass(frozen=True, eq=False)
class ReadingReliability:
    """Of each reading: quantity -> (N,), NaN where it was not measured.

    numbers: redundancy numbers, NaN where the method takes readings as exact; detectable: smallest
    detectable error [SI], inf where the others do not control it; effect: rms displacement [unit]
    of predictions that an error of this size causes, NaN without outputs; poses: their ids.
    """

    __repr__ = brief

    numbers: dict[str, Array]
    detectable: dict[str, Array]
    effect: dict[str, Array]
    units: dict[str, str]
    unit: str | None
    poses: tuple[str, ...]
    alpha: float = ALPHA
    power: float = POWER

    @property
    def noncentrality(self) -> float:
        """The detectable error in sds of its test statistic."""
        return noncentrality(self.alpha, self.power)

    @property
    def entry(self) -> Reliability:
        """As a document holds it: by sensor."""
        sensors = tuple(
            self._sensor(q) for q in self.detectable if not np.isnan(self.detectable[q]).all()
        )
        return Reliability(self.alpha, self.power, self.noncentrality, self.unit, sensors)

    def _sensor(self, quantity: str) -> SensorReliability:
        detectable, effect = self.detectable[quantity], self.effect[quantity]
        tested, hidden = np.isfinite(detectable), int(np.isinf(detectable).sum())
        number = self.numbers[quantity][np.isfinite(self.numbers[quantity])]
        share = min(max(float(np.median(number)), 0.0), 1.0) if number.size else None
        middle = largest = moved = pose = None
        if tested.any():
            middle, largest = float(np.median(detectable[tested])), float(detectable[tested].max())
        bounded = tested & np.isfinite(effect)
        if bounded.any():
            worst = int(np.argmax(np.where(bounded, effect, -1.0)))
            moved, pose = finite(float(effect[worst])), self.poses[worst]
        unit, count = self.units[quantity], int(tested.sum())
        return SensorReliability(quantity, unit, count, hidden, share, middle, largest, moved, pose)


def noncentrality(alpha: float = ALPHA, power: float = POWER) -> float:
    """z(1 - alpha / 2) + z(power).

    >>> round(noncentrality(), 2)
    4.13
    """
    normal = NormalDist()
    return normal.inv_cdf(1.0 - 0.5 * alpha) + normal.inv_cdf(power)


def reliability(
    result: FitResult, *, alpha: float = ALPHA, power: float = POWER
) -> ReadingReliability | None:
    """The reliability of every reading of a calibration.

    None of a stream, whose readings are not in memory, and under a robust loss.
    """
    if result.all_poses is not None or result.fit.robust_loss is not None:
        return None
    with one_blas_thread():
        problem, solution, method = result.problem, result.solution, result.fit.solver
        equations = result.pose_equations()
        covariance = solution.spectrum.covariance()
        variance = method.unit_variance(result.information.chi_squared, result.freedom)
        scale = np.sqrt(1.0 if variance is None else variance)
        checked = redundancy(problem, equations, covariance)
        whole = np.zeros(problem.readings.shape)
        for block in equations:
            whole[:, block.poses] = block.squares.T
        tested = checked.power > UNCONTROLLED * whole
        root = np.sqrt(np.where(tested, checked.power, 1.0))
        detectable = np.where(tested, noncentrality(alpha, power) * scale / root, np.inf)
        detectable[np.isnan(checked.power)] = np.nan
        moved = _moved(result, equations, covariance)
        effect = np.where(tested, detectable, np.nan) * moved.by_error
        names = problem.mechanism.tape.quantities
        numbers = np.full_like(root, np.nan) if method.exact else checked.numbers
        shown = [i for i, q in enumerate(names) if q not in problem.mechanism.disturbances]

        def by_name(part: Array) -> dict[str, Array]:
            return {names[i]: part[i] for i in shown}

        return ReadingReliability(
            by_name(numbers),
            by_name(detectable),
            by_name(effect),
            {names[i]: problem.mechanism.quantities[names[i]] for i in shown},
            moved.unit,
            tuple(problem.poses),
            alpha,
            power,
        )


@dataclass(frozen=True)
class _Moved:
    """by_error: (k, N) rms displacement of predictions per unit of an error [unit/SI]; unit: SI,
    None and NaN where nothing is predicted."""

    by_error: Array
    unit: str | None


def _moved(result: FitResult, equations: tuple[PoseEquations, ...], covariance: Array) -> _Moved:
    problem = result.problem
    by_error = np.full(problem.readings.shape, np.nan)
    outputs = problem.mechanism.outputs
    if not outputs:
        return _Moved(by_error, None)
    units = [problem.mechanism.quantities[q] for q in outputs]
    unit = "m" if "m" in units else units[0]
    groups = [group for group in output_groups(problem.mechanism) if group.unit == unit]
    rows = [row for group in groups for row in group.rows]
    squares = _squares(result, problem, rows, len(groups))
    if squares is None:
        return _Moved(by_error, None)
    # |effect|^2 = d^2 x^T D C M C D^T x, M the mean of S^T S over the poses.
    root = covariance @ squares @ covariance
    for block in equations:
        spread = rows_times(block.D, root) @ block.D.transpose(0, 2, 1)
        size = np.einsum("brk,brk->bk", block.X, spread @ block.X)
        by_error[:, block.poses] = np.sqrt(np.maximum(size, 0.0)).T
    return _Moved(by_error, unit)


def _squares(result: FitResult, problem: Problem, rows: list[int], count: int) -> Array | None:
    """(n, n) mean over poses and points of the squared displacement per parameter step.

    rows: outputs of so many points."""
    chosen = np.arange(0, len(problem.poses), max(1, -(-len(problem.poses) // _MOST)))
    x = (problem.readings + result.solution.corrections)[:, chosen]
    unread = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)).all(axis=1)
    values = result.solution.parameters
    S = output_sensitivity(
        problem.mechanism,
        values,
        problem.names,
        x,
        problem.pose_constants[:, chosen],
        np.flatnonzero(unread).tolist(),
    ).by_parameter[:, rows]
    S = S[np.isfinite(S).all(axis=(1, 2))]
    if not len(S):
        return None
    flat = S.reshape(-1, S.shape[2])
    return flat.T @ flat / (len(S) * count)
