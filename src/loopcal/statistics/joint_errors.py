"""Errors of joints that are the same wherever a joint stands the same: what share of their noise?

A gear or an encoder errs by a function of its joint. A calibration that has no term for it learns
it as noise of the joint's reading. Poses of another day, where joints stand elsewhere, then share
errors that the calibration calls independent, and a change that they resemble looks too sure. So
let a share r of the variance s_j^2 of a joint be a function of its reading q_j,

    g_j = s_j sqrt(r / K) sum_k h_jk c_k(x_j),   h ~ N(0, 1),   k = 0 .. K - 1,

c_0 = 1, c_k = sqrt(2) cos(k pi x), x_j in [0, 1] the place of q_j between the least and the largest
reading of these poses, and B the columns of h in the misclosures e (`innovation`):

    e = X t + A h_machine + sqrt(r) B h + v,   v ~ N(0, k),

X the columns of what was placed anew and of the changes that were accepted. What such errors cannot
do, waves that average out over these poses, stays in v. r is uniform in [0, 1] before; the
restricted likelihood (Patterson and Thompson 1971), with k where it is largest, gives its mean and
its sd, and K is the likeliest of a few. Since r is a share, a large change stays as visible as it
was. Where readings are taken as exact, s_j is such that each joint would cause as much of the
misclosures, and all together their variance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array, span
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.statistics.innovation import Linearised

# Chosen, not derived: from one wave over the measured range to more than poses resolve.
_WAVES = (3, 6, 12)
"""How many functions of a joint are compared."""
_SHARES = np.linspace(0.0, 1.0, 21)
# Chosen, not derived: far above rounding, far below a direction that poses show.
_SHOWN = 1e-6


@dataclass(frozen=True)
class JointErrors:
    """waves: functions of each joint; share: of the variance of its reading, above 0; sd: of the
    share."""

    waves: int
    share: float
    sd: float

    @classmethod
    def of(cls, linear: Linearised, changes: Array) -> JointErrors | None:
        """From the equations of a day after changes with these columns (R, m); None where no joint
        turns or is read with noise, nothing is left of the equations, or the share is 0."""
        Q = span(np.hstack([linear.F, changes]), _SHOWN)
        count = len(linear.e) - Q.shape[1]
        left, A = (M - Q @ (Q.T @ M) for M in (linear.e, linear.A))
        # In the metric of 1 + A A^T, the inverse of which is 1 - A L^-T L^-1 A^T.
        L = np.linalg.cholesky(np.eye(A.shape[1]) + A.T @ A)
        a = np.linalg.solve(L, A.T @ left)
        total, made = float(left @ left - a @ a), []
        for waves in _WAVES:
            B = _columns(linear, waves)
            if not B.any() or count <= 0 or total <= 0.0:
                return None
            B = B - Q @ (Q.T @ B)
            C = np.linalg.solve(L, A.T @ B)
            values, vectors = np.linalg.eigh(B.T @ B - C.T @ C)
            z = np.square(vectors.T @ (B.T @ left - C.T @ a))
            variances = 1.0 + _SHARES[:, None] * np.maximum(values, 0.0)
            squares = total - _SHARES * (z / variances).sum(axis=1)
            logs = -0.5 * (count * np.log(squares) + np.log(variances).sum(axis=1))
            made.append((float(np.logaddexp.reduce(logs)), waves, logs))
        _, waves, logs = max(made, key=lambda one: one[0])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        share = float(weights @ _SHARES)
        sd = float(np.sqrt(weights @ np.square(_SHARES - share)))
        return cls(waves, share, sd) if share > 0.0 else None

    def within(self, linear: Linearised) -> Linearised:
        """The equations of a machine whose joints err so."""
        B = np.sqrt(self.share) * _columns(linear, self.waves)
        (n, r), m = linear.root.shape, B.shape[1]
        # Relative change of the variance of each h by one sd of the share.
        unsure = np.zeros((1, r + m, r + m))
        unsure[0, range(r, r + m), range(r, r + m)] = self.sd / self.share
        slopes = np.pad(linear.slopes, ((0, 0), (0, m), (0, m)))
        return replace(
            linear,
            A=np.hstack([linear.A, B]),
            root=np.hstack([linear.root, np.zeros((n, m))]),
            slopes=np.concatenate([slopes, unsure]),
        )


def _columns(linear: Linearised, waves: int) -> Array:
    """(R, joints * waves) of the functions of each joint, each of variance s_j^2 / K."""
    placement, k = linear.placement, np.arange(waves)[:, None]
    problem = placement.problem
    rows = [row for row in joint_rows(problem) if np.ptp(problem.readings[row]) > 0.0]
    zeros = placement.columns([problem.mechanism.tape.quantities[row] for row in rows])
    zeros = zeros / np.sqrt(linear.factor)
    exact = not problem.uncertainty.sd[rows].any()
    columns = [np.zeros((len(linear.e), 0))]
    for row, zero in zip(rows, zeros.T, strict=True):
        sd, q = problem.uncertainty.sd[row], problem.readings[row]
        if exact:
            sd = np.full(len(q), np.sqrt(len(zero) / len(rows)) / max(np.linalg.norm(zero), 1e-300))
        c = np.where(k == 0, 1.0, np.sqrt(2.0)) * np.cos(np.pi * k * (q - q.min()) / np.ptp(q))
        columns.append(zero[:, None] * (sd / np.sqrt(waves) * c).T[placement.row_poses])
    return np.hstack(columns)
