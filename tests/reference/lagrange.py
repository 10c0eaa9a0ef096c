"""The whole calibration as one dense system: Newton's method on all stationarity conditions.

minimise sum_i c_i^T P_i c_i + (p - nominal)^T W (p - nominal) subject to f(reading_i + c_i, p) = 0

for corrections c, parameters p and multipliers together, with the exact second derivatives of the
Lagrangian (complex step of its gradient). Slow, plain, and without a line of the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.derivative import linearise
from loopcal.expressions.tape import Tape
from tests.reference.plain_tape import STEP, loop_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stationary:
    """parameters (n,), corrections (k, N), covariance (n, n) of the linearised problem.

    merit: sum of both weighted squares; change: of the last Newton step, in parameters.
    """

    parameters: Array
    corrections: Array
    covariance: Array
    merit: float
    change: float


class DenseLagrange:
    """precision (N, k, k) or (k, k): zero rows where unmeasured; exact: rows never corrected."""

    def __init__(
        self,
        tape: Tape,
        readings: Array,
        precision: Array,
        nominal: Array,
        prior_precision: Array,
        exact: tuple[int, ...] = (),
    ) -> None:
        self.tape = tape
        self.slopes = linearise(tape, tape.quantities, tape.parameters).tape
        self.readings = readings
        k, poses = readings.shape
        self.precision = np.broadcast_to(precision, (poses, k, k))
        self.nominal = nominal
        self.prior_precision = prior_precision
        self.free = [i for i in range(k) if i not in exact]
        self.shape = (len(tape.loops), k, len(nominal), poses)

    def linearised(self, c: NDArray, p: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """f (m, N), df/dx (k, m, N), df/dp (n, m, N); complex where c or p are.

        For many places at once of c (k, d, N) and p (n, d), ahead of N in what is returned.
        """
        m, k, n, _ = self.shape
        shape = np.broadcast_shapes(c.shape[1:], (*p.shape[1:], 1))
        x = (self.readings if c.ndim == 2 else self.readings[:, None]) + c
        out = loop_values(self.slopes, x, np.broadcast_to(p[..., None], (n, *shape)))
        return (
            out[:m],
            out[m : m + k * m].reshape(k, m, *shape),
            out[m + k * m :].reshape(n, m, *shape),
        )

    def gradient(self, c: NDArray, p: NDArray, multipliers: NDArray) -> tuple[NDArray, ...]:
        """Gradient of the Lagrangian by c (k, N) and by p (n,), and the loops f (m, N).

        Or of many places at once, as in `linearised`.
        """
        f, by_x, by_p = self.linearised(c, p)
        by_c = np.einsum("bij,j...b->i...b", self.precision, c) + np.einsum(
            "km...b,mb->k...b", by_x, multipliers
        )
        offset = p - (self.nominal if p.ndim == 1 else self.nominal[:, None])
        by_p = self.prior_precision @ offset + np.einsum("nm...b,mb->n...", by_p, multipliers)
        return by_c, by_p, f

    def matrix(self, c: Array, p: Array, multipliers: Array, *, exact: bool) -> Array:
        """Derivative of all conditions: unknowns c (pose by pose), then p, then multipliers.

        exact: with the second derivatives of the loops; without them its inverse holds the
        covariance of the parameters.
        """
        m, _, n, poses = self.shape
        u = len(self.free)
        size = poses * (u + m) + n
        K = np.zeros((size, size))
        at_p, at_f = poses * u, poses * u + n
        _, by_x, by_p = self.linearised(c, p)
        for b in range(poses):
            own, loops = slice(b * u, b * u + u), slice(at_f + b * m, at_f + b * m + m)
            K[own, own] = self.precision[b][np.ix_(self.free, self.free)]
            K[loops, own] = by_x[self.free, :, b].T
            K[own, loops] = by_x[self.free, :, b]
            K[loops, at_p:at_f] = by_p[:, :, b].T
            K[at_p:at_f, loops] = by_p[:, :, b]
        K[at_p:at_f, at_p:at_f] = self.prior_precision
        if exact:
            self._add_curvature(K, c, p, multipliers)
        return K

    def _add_curvature(self, K: Array, c: Array, p: Array, multipliers: Array) -> None:
        _, k, n, poses = self.shape
        u, at_p = len(self.free), poses * len(self.free)
        # One place for each row; poses do not see each other's corrections.
        moved = c[:, None] + 1j * STEP * np.eye(k)[:, self.free, None]
        by_c, _, _ = self.gradient(moved, p[:, None], multipliers)
        slope = np.imag(by_c)[self.free] / STEP
        for b in range(poses):
            own = slice(b * u, b * u + u)
            K[own, own] = slope[:, :, b]
        shifted = p[:, None] + 1j * STEP * np.eye(n)
        by_c, by_p, _ = self.gradient(c[:, None], shifted, multipliers)
        columns = np.imag(by_c)[self.free].transpose(2, 0, 1).reshape(at_p, n) / STEP
        K[:at_p, at_p : at_p + n] = columns
        K[at_p : at_p + n, :at_p] = columns.T
        K[at_p : at_p + n, at_p : at_p + n] = np.imag(by_p) / STEP

    def solve(self, p: Array, c: Array | None = None, iterations: int = 12) -> Stationary:
        """Newton's method from parameters p and corrections c (default 0), undamped."""
        m, k, n, poses = self.shape
        u = len(self.free)
        c = np.zeros((k, poses)) if c is None else c.copy()
        multipliers = np.zeros((m, poses))
        change = np.inf
        for iteration in range(iterations):
            by_c, by_p, f = self.gradient(c, p, multipliers)
            conditions = np.concatenate([by_c[self.free].T.ravel(), by_p, f.T.ravel()])
            # the first steps without curvature, whose multipliers are not yet right
            K = self.matrix(c, p, multipliers, exact=iteration >= 2)
            step = -_solve(K, conditions)
            c[self.free] += step[: poses * u].reshape(poses, u).T
            p = p + step[poses * u : poses * u + n]
            multipliers = multipliers + step[poses * u + n :].reshape(poses, m).T
            change = float(abs(step[poses * u : poses * u + n]).max())
        offset = p - self.nominal
        merit = np.einsum("ib,bij,jb->", c, self.precision, c)
        K = self.matrix(c, p, multipliers, exact=False)
        unit = np.zeros((len(K), n))
        unit[poses * u : poses * u + n] = np.eye(n)
        covariance = _solve(K, unit)[poses * u : poses * u + n]
        return Stationary(
            p, c, covariance, float(merit + offset @ self.prior_precision @ offset), change
        )


def _solve(K: Array, right: Array) -> Array:
    """K^-1 right with rows and columns scaled to one, because precisions reach 1e12."""
    scale: Array = np.ones(len(K))
    for _ in range(5):
        largest = np.max(abs(K * scale * scale[:, None]), axis=0, initial=1e-300)
        np.divide(scale, np.sqrt(largest), out=scale)
    scaled = right * (scale[:, None] if right.ndim == 2 else scale)
    solved = np.asarray(np.linalg.solve(K * scale * scale[:, None], scaled), dtype=np.float64)
    return solved * (scale[:, None] if right.ndim == 2 else scale)
