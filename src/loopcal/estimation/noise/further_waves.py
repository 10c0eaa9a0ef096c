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

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.mechanisms.structure.smooth import Smooth
from loopcal.mechanisms.structure.structured import DISCREPANCY, structure_of

Array = NDArray[np.float64]
_MOST = 60
"""Vectors k of the discrepancy and of the waves that follow, together."""


def shared(
    problem: Problem, corrections: Array, equations: Sequence[PoseEquations], root: Array
) -> Array | None:
    """(k, k) what the covariance of z gains by waves that the discrepancy leaves out.

    equations: of the poses where the fit ended; root: (n, k), dp = root z. None without a
    discrepancy or equations, where a loop joins two poses, and where no such waves are seen.
    """
    smooth = structure_of(problem.mechanism).smooth
    if smooth is None or any(v.first is not None for v in problem.mechanism.variables):
        return None
    following = smooth.following(_MOST)
    rows = _columns(problem, smooth)
    if not following.harmonics or not rows or not equations:
        return None
    names = problem.mechanism.tape.quantities
    here = {q: problem.readings[i] + corrections[i] for i, q in enumerate(names)}
    known, further = (np.array(waves.features(here)) for waves in (smooth, following))
    k = root.shape[1]
    D, Z, E = [], [], []
    for block in equations:
        F, G = known[:, block.poses].T, further[:, block.poses].T
        D.append(rows_times(block.D, root).reshape(-1, k))
        E.append(block.E.ravel())
        # the squares of the known features sum to 1 in every pose
        shifts = [np.einsum("brf,bf->br", block.D[:, :, row], F) for row in rows]
        waves = [X[:, :, None] * G[:, None, :] for X in shifts]
        Z.append(np.concatenate(waves, axis=2).reshape(len(E[-1]), -1))
    return _gained(*(np.concatenate(parts) for parts in (D, Z, E)))


def _columns(problem: Problem, smooth: Smooth) -> list[list[int]]:
    """The estimated coefficients of the discrepancy, by position, for each axis."""
    names = [problem.mechanism.parameters.names[i] for i in problem.free]
    place = {name: i for i, name in enumerate(names)}
    parts = [f"{part}{i}" for i in range(1, len(smooth.harmonics) + 1) for part in ("cos", "sin")]
    axes = ("x", "y", "z", "rx", "ry", "rz")
    wanted = [[f"{DISCREPANCY}_{axis}_{part}" for part in parts] for axis in axes]
    return [[place[n] for n in row] for row in wanted if all(n in place for n in row)]


def _gained(D: Array, Z: Array, E: Array) -> Array | None:
    H, B, ZZ = D.T @ D, D.T @ Z, Z.T @ Z
    BB, HB = B.T @ B, H @ B
    C = ZZ - BB
    cross = float(np.trace(ZZ) - 2.0 * np.trace(BB) + np.sum(B * HB))
    trace, square = float(np.trace(H)), float(np.sum(H * H))
    system = np.array([[len(E) - 2.0 * trace + square, cross], [cross, float(np.sum(C * C))]])
    seen = Z.T @ E
    moments = [
        float(E @ E) - (trace - square),
        float(seen @ seen) - float(np.trace(BB) - np.sum(B * HB)),
    ]
    white, waves = np.linalg.solve(system, moments)
    if not (waves > 0.0 and white > 0.0):
        return None
    found: Array = waves * (B @ B.T) + (white - 1.0) * H
    return found
