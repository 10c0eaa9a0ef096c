"""What a smooth discrepancy of a few waves cannot follow, as an error that neighbours share.

The discrepancy is a sum of the waves of largest weight (`mechanisms.structure.smooth`). The waves
that follow are errors of the machine too. To the fit they are noise, but alike in neighbouring
poses, so that they do not average out: far from the measured poses the fit is less sure than
independent errors would make it. With E = D z + v, D^T D + P = I, and Z the rows of the waves that
follow, of amplitudes tau b, b ~ N(0, I),

    E = D z + Z tau b + v,   cov v = sigma^2 I,   cov z = P + sigma^2 H + tau^2 B B^T,

H = D^T D, B = D^T Z: a sandwich with the covariance of these errors inside. The fit's residuals
e = Q E, Q = I - D D^T, with what the prior leaves of them, have the moments

    E e^T e     = sigma^2 tr Q^2      + tau^2 tr Z^T Q^2 Z + tr P H,
    E |Z^T e|^2 = sigma^2 tr Z^T Q^2 Z + tau^2 tr C^2      + tr B^T P B,   C = Z^T Z - B^T B,

from which sigma^2 and tau^2 follow; tau^2 is taken as 0 where it comes out below.

Source: Rao (1971), estimation of variance components by quadratic forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.dependence.seen import Seen
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.mechanisms.structure.smooth import Smooth
from loopcal.mechanisms.structure.structured import DISCREPANCY

Array = NDArray[np.float64]
# docs/decisions/0049.
_MOST = 60
"""Vectors k of the discrepancy and of the waves that follow, together."""


def shared(
    problem: Problem, corrections: Array, equations: Sequence[PoseEquations], root: Array
) -> Array | None:
    """(k, k) what the covariance of z gains by waves that the discrepancy leaves out.

    equations: of the poses where the fit ended; root: (n, k), dp = root z. None without a
    discrepancy or equations, where a loop joins two poses, and where no such waves are seen.
    """
    structure = problem.mechanism.structure
    smooth = None if structure is None else structure.smooth
    if smooth is None or any(v.first is not None for v in problem.mechanism.variables):
        return None
    following = smooth.following(_MOST)
    rows = _columns(problem, smooth)
    if not following.harmonics or not rows or not equations:
        return None
    names = problem.mechanism.tape.quantities
    readings = {q: problem.readings[i] + corrections[i] for i, q in enumerate(names)}
    included, further = (np.array(waves.features(readings)) for waves in (smooth, following))
    N, k = len(problem.poses), root.shape[1]
    y, A, M = (
        np.zeros((N, len(rows))),
        np.zeros((N, len(rows), k)),
        np.zeros((N, *2 * (len(rows),))),
    )
    square, count = 0.0, 0
    for block in equations:
        F = included[:, block.poses].T
        # what a shift of the body does: the squares of the known features sum to 1 in every pose
        X = np.stack([np.einsum("brf,bf->br", block.D[:, :, row], F) for row in rows], axis=1)
        y[block.poses] = np.einsum("bqr,br->bq", X, block.E)
        A[block.poses] = rows_times(X @ block.D, root)
        M[block.poses] = X @ np.swapaxes(X, 1, 2)
        square, count = square + float(np.square(block.E).sum()), count + block.E.size
    informed = root / problem.prior_sd[:, None]
    H = np.eye(k) - informed.T @ informed
    return _gained(_Sums.of(Seen(y, A, M), further.T), H, square, count)


def _columns(problem: Problem, smooth: Smooth) -> list[list[int]]:
    """The estimated coefficients of the discrepancy, by position, for each axis."""
    names = [problem.mechanism.parameters.names[i] for i in problem.free]
    place = {name: i for i, name in enumerate(names)}
    axes = ("x", "y", "z", "rx", "ry", "rz")
    wanted = [[f"{DISCREPANCY}_{axis}_{part}" for part in smooth.parts] for axis in axes]
    return [[place[n] for n in row] for row in wanted if all(n in place for n in row)]


@dataclass(frozen=True)
class _Sums:
    """Over all poses: B = D^T Z (k, w), ZZ = Z^T Z (w, w) and seen = Z^T E (w,)."""

    B: Array
    ZZ: Array
    seen: Array

    @classmethod
    def of(cls, shifts: Seen, G: Array) -> _Sums:
        """Of poses as shifts of the body see them, and waves G (N, f): Z = X G, axis by axis."""
        q, f = shifts.y.shape[1], G.shape[1]
        ZZ = np.zeros((q, f, q, f))
        for a, b in combinations_with_replacement(range(q), 2):
            ZZ[a, :, b] = (G * shifts.M[:, a, b, None]).T @ G
            ZZ[b, :, a] = ZZ[a, :, b]
        B = np.concatenate([shifts.A[:, a].T @ G for a in range(q)], axis=1)
        return cls(B, ZZ.reshape(q * f, q * f), (shifts.y.T @ G).ravel())


def _gained(sums: _Sums, H: Array, square: float, count: int) -> Array | None:
    """(k, k) what the covariance of z gains; square: E^T E of so many equations."""
    B = sums.B
    BB, HB = B.T @ B, H @ B
    C = sums.ZZ - BB
    cross = float(np.trace(sums.ZZ) - 2.0 * np.trace(BB) + np.sum(B * HB))
    trace, squares = float(np.trace(H)), float(np.sum(H * H))
    system = np.array([[count - 2.0 * trace + squares, cross], [cross, float(np.sum(C * C))]])
    moments = [
        square - (trace - squares),
        float(sums.seen @ sums.seen) - float(np.trace(BB) - np.sum(B * HB)),
    ]
    white, waves = np.linalg.solve(system, moments)
    if not (waves > 0.0 and white > 0.0):
        return None
    # P + H = 1 holds H at variance 1 already, so only the difference is gained.
    gain: Array = waves * (B @ B.T) + (white - 1.0) * H
    return gain
