"""The covariance of poses that a fit has not seen, but whose run it has.

Where errors drift along a run (`estimation.dependence.serial`), the level of the drift is in the
parameters already: an offset of the wire moves the anchor. A pose of the same run shares that
level. In directions z of the parameters with D^T D + P = I, and u the drift, its misclosure is

    E_i = v_i + X_i u_i - D_i z,   z = -sum_j D_j^T (X_j u_j + v_j) + prior part,

over the poses j of the fit; so with A_j = X_j^T D_j and R_ij = cov(u_i, u_j)

    cov E_i = s^2 I + X_i R_ii X_i^T + D_i V D_i^T - X_i K_i D_i^T - (X_i K_i D_i^T)^T,
    V = s^2 D^T D + P + sum_jl A_j^T R_jl A_l,   K_i = sum_j R_ij A_j.

Without the last two terms level and drift would count twice, as they do for a pose of another day.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.dependence.dependence import Drifting
from loopcal.estimation.dependence.seen import seen, units_of
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import Result

Array = NDArray[np.float64]
Positions = NDArray[np.intp]
# The correlations of 3000 poses by pairs take 72 MB.
_MOST = 3000
"""Poses of a run whose correlations are computed pair by pair."""


@dataclass(frozen=True)
class Run:
    """Positions in one run: fitted (N,) of the poses of a fit, held (n,) of those it predicts."""

    fitted: Positions
    held: Positions

    def ordered(self, fit: Problem, held: Problem) -> Run:
        """Numbers in the order of measuring: by the known time if there is one, else as given."""
        times = [i for i, unit in enumerate(fit.mechanism.pose_constants.values()) if unit == "s"]
        when = np.concatenate([self.fitted, self.held]).astype(float)
        if len(times) == 1:
            when = np.concatenate([fit.pose_constants[times[0]], held.pose_constants[times[0]]])
        # Twice gives ranks; stable, so that equal times stay in the order of the rows.
        number = np.argsort(np.argsort(when, kind="stable"), kind="stable")
        return Run(number[: len(self.fitted)], number[len(self.fitted) :])


@dataclass(frozen=True, eq=False)
class SameRun:
    """What poses of the same run share with a fit.

    white: variance of an equation; level: of a drifting reading in units of its sd; V (k, k),
    K (n, q, k), X (n, R, q) whitened; root (m, k).
    """

    white: float
    level: float
    V: Array
    K: Array
    X: Array
    root: Array

    @classmethod
    def of(
        cls, fit: Result, held: Problem, corrections: Array, drifting: Drifting, run: Run
    ) -> SameRun | None:
        """Of poses that a fit has not seen; None where they are too many."""
        problem, solution = fit.problem, fit.solution
        if len(run.fitted) != len(problem.poses) or len(run.fitted) > _MOST:
            return None
        run, drift, root = run.ordered(problem, held), drifting.drift, solution.spectrum.root
        A = seen(problem, fit.pose_equations(), root, drifting.readings).A
        N, q, k = A.shape
        P = root.T @ (problem.precision[:, None] * root)
        flat = A.reshape(N, q * k)
        along = (_kernel(drift.lengths, drift.sizes, run.fitted, run.fitted) @ flat).reshape(-1, k)
        K = _kernel(drift.lengths, drift.sizes, run.held, run.fitted) @ flat
        return cls(
            drift.white,
            float(drift.sizes.sum()),
            # D^T D = I - P in these directions.
            drift.white * (np.eye(k) - P) + P + A.reshape(-1, k).T @ along,
            K.reshape(-1, q, k),
            _effects(fit, held, corrections, drifting.readings),
            root,
        )

    def covariance(self, poses: Positions, W: Array, J: Array) -> Array:
        """(b, r, r) of the misclosures of these poses.

        W (b, r, r): their noise at the sds of the fit; J (b, r, m): derivatives by parameters.
        """
        D, r = rows_times(J, self.root), W.shape[1]
        # W = L L^T: L takes the whitened effects back to the units of the misclosures.
        X = np.linalg.cholesky(W) @ self.X[poses, :r]
        shared = X @ self.K[poses] @ np.swapaxes(D, -1, -2)
        noise = self.white * W + self.level * X @ np.swapaxes(X, -1, -2)
        fitted = rows_times(D, self.V) @ np.swapaxes(D, -1, -2)
        total: Array = noise + fitted - shared - np.swapaxes(shared, -1, -2)
        return total


def _kernel(lengths: Array, sizes: Array, rows: Positions, columns: Positions) -> Array:
    """cov(u_i, u_j) of poses with these numbers."""
    apart = np.abs(rows[:, None] - columns[None, :]).astype(float)
    kernel: Array = np.zeros_like(apart)
    # AR(1) of several lengths (record 0050); poses apart by d correlate as exp(-d / length).
    for length, size in zip(lengths.tolist(), sizes.tolist(), strict=True):
        if size > 0.0:
            kernel += size * np.exp(-apart / length)
    return kernel


def _effects(fit: Result, held: Problem, corrections: Array, readings: tuple[str, ...]) -> Array:
    """(n, R, q) what an error of one sd of these readings does to the whitened equations."""
    rows = [held.mechanism.tape.quantities.index(name) for name in readings]
    equations = pose_equations(held, held.start, corrections)
    most = max((block.E.shape[1] for block in equations), default=0)
    effects = np.zeros((len(held.poses), most, len(rows)))
    units = units_of(fit.problem, rows)
    missing = np.isinf(np.broadcast_to(held.uncertainty.sd, held.readings.shape)[rows])
    for block in equations:
        # What was not read carries no drift.
        whitened = block.X[:, :, rows] * units * ~missing.T[block.poses][:, None, :]
        effects[block.poses, : block.E.shape[1]] = whitened
    return effects
