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
_MOST = 3000
"""Poses of a run whose correlations are computed pair by pair."""


@dataclass(frozen=True)
class Run:
    """Positions in one run: fitted (N,) of the poses of a fit, held (n,) of those it predicts."""

    fitted: Positions
    held: Positions

    def ordered(self, fit: Problem, held: Problem) -> Run:
        """Numbers in the order of measuring: by the known time if there is one, else as given."""
        times = [i for i, unit in enumerate(fit.mechanism.known.values()) if unit == "s"]
        when = np.concatenate([self.fitted, self.held]).astype(float)
        if len(times) == 1:
            when = np.concatenate([fit.known[times[0]], held.known[times[0]]])
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
        precision = (
            np.zeros(len(root)) if fit.fit.solver.exact else 1.0 / np.square(problem.prior_sd)
        )
        P = root.T @ (precision[:, None] * root)
        flat = A.reshape(N, q * k)
        along = (_kernel(drift.lengths, drift.sizes, run.fitted, run.fitted) @ flat).reshape(-1, k)
        K = _kernel(drift.lengths, drift.sizes, run.held, run.fitted) @ flat
        return cls(
            drift.white,
            float(drift.sizes.sum()),
            drift.white * (np.eye(k) - P) + P + A.reshape(-1, k).T @ along,
            K.reshape(-1, q, k),
            _effects(fit, held, corrections, drifting.readings),
            root,
        )

    def covariance(self, poses: Positions, W: Array, J: Array) -> Array:
        """(b, r, r) of the misclosures of these poses, whose own noise at the sds of the fit is
        W (b, r, r), and J (b, r, m)."""
        D, r = rows_times(J, self.root), W.shape[1]
        X = np.linalg.cholesky(W) @ self.X[poses, :r]
        shared = X @ self.K[poses] @ np.swapaxes(D, -1, -2)
        own = self.white * W + self.level * X @ np.swapaxes(X, -1, -2)
        fitted = rows_times(D, self.V) @ np.swapaxes(D, -1, -2)
        found: Array = own + fitted - shared - np.swapaxes(shared, -1, -2)
        return found


def _kernel(lengths: Array, sizes: Array, rows: Positions, columns: Positions) -> Array:
    """cov(u_i, u_j) of poses with these numbers."""
    apart = np.abs(rows[:, None] - columns[None, :]).astype(float)
    found: Array = np.zeros_like(apart)
    for length, size in zip(lengths.tolist(), sizes.tolist(), strict=True):
        if size > 0.0:
            found += size * np.exp(-apart / length)
    return found


def _effects(fit: Result, held: Problem, corrections: Array, readings: tuple[str, ...]) -> Array:
    """(n, R, q) what an error of one sd of these readings does to the whitened equations."""
    rows = [held.mechanism.tape.quantities.index(name) for name in readings]
    equations = pose_equations(held, held.start, corrections, exact=fit.fit.solver.exact)
    most = max((block.E.shape[1] for block in equations), default=0)
    found = np.zeros((len(held.poses), most, len(rows)))
    units = units_of(fit.problem, rows)
    missing = np.isinf(np.broadcast_to(held.uncertainty.sd, held.readings.shape)[rows])
    for block in equations:
        here = block.X[:, :, rows] * units * ~missing.T[block.poses][:, None, :]
        found[block.poses, : block.E.shape[1]] = here
    return found
