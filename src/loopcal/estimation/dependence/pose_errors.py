"""Errors of the poses that a robot states, alike in poses that are near each other.

The geometry of an arm makes errors of its stated poses that change slowly from pose to pose. They
do not average out as independent ones do, and parameters take up a part of them. In units of the
learnt sds, along the axes of the base,

    E_i = D_i dp + X_i u_i + v_i,   cov(u_i, u_j) = t ((1 - c) delta_ij + c k_ij) I,
    k_ij = exp(-(d_ij^2 + w a_ij^2) / (2 (1 + w) l^2)),

d and a: how far two poses are apart and turned, in units of the root mean square over all pairs.
Each image shows z_i = M_i^-1 X_i^T E_i, M_i = X_i^T X_i, with the covariance

    cov(z_i, z_j) = delta_ij (M_i^-1 - I) + cov(u_i, u_j),

and what is left of E_i says nothing of u_i. With the mean of M_i^-1 - I over the images, vectors of
k and of that mean make this diagonal, so that each point of a grid of t, c, l costs O(N). The
estimate stays; its covariance gains sum_ij A_i^T (cov(u_i, u_j) - delta_ij I) A_j, A_i = X_i^T D_i,
averaged over the grid by restricted likelihood. An sd that is learnt as 0 leaves no unit: then the
unit has as large an effect on the pixels as that of the other, and its I is 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import SmoothErrors
from loopcal.estimation.dependence.seen import Seen, seen
from loopcal.estimation.dependence.stated_poses import QUANTITIES, StatedPoses
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times

# docs/decisions/0161, in units of the root mean square over all pairs of poses.
LENGTHS = (0.5, 0.8, 1.2)
_SHARES = (0.0, 0.25, 0.5, 0.75, 0.97)
_VARIANCES = 2.0 ** np.arange(-1.0, 4.1, 0.5)
# Chosen, not derived: variance and length are learnt as well from so many poses.
_MOST = 300
# Chosen, not derived: an image of few corners says little, and the mean is to hold for the others.
_POOR = 4.0
"""Images whose pixels leave their pose so much less sure than the median one are left out."""
_LEAST = 1e-8
"""Of M: a direction of a pose that no corner shows."""


class PoseErrors(NamedTuple):
    """gained: (k, k) what the covariance of z gains; slope: (k, k) by how much one sd of the smooth
    part changes that; smooth: what predictions of other poses need, None of joints."""

    gained: Array
    slope: Array
    smooth: SmoothErrors | None = None


def pose_errors(
    problem: Problem, parameters: Array, equations: Sequence[PoseEquations], root: Array
) -> PoseErrors | None:
    """What they mean for the covariance of z, and for predictions.

    dp = root z, root^T (H + P) root = I; root: (n, k); parameters (n_all,), equations: where the
    fit ended.

    None where no robot states the poses, or all sds of them are learnt as 0.
    """
    poses = StatedPoses.of(problem)
    if poses is None or not equations:
        return None
    sd, learnt = _usual_sds(problem), np.ones(6)
    units = sd
    if not sd.any() or not np.isfinite(sd).all():
        return None
    view = along_base(seen(problem, equations, root, QUANTITIES), poses.R)
    if not sd.all():  # in SI
        learnt = (sd > 0.0).astype(float)
        effect = np.einsum("nqq->q", view.M)
        turned = float(effect @ sd**2) / float((effect * (1.0 - learnt)).sum())
        units = np.where(sd > 0.0, sd, math.sqrt(turned))
        view = scaled(view, units)
    away = problem.precision * (problem.nominal - parameters[problem.free])
    pull = root.T @ np.where(problem.precision > 0.0, away, 0.0)
    grid = Grid.of(pull, equations, root, view, learnt)
    if grid is None:
        return None
    criteria, place, share, variance = grid.points(poses).T
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    weights /= weights.sum()
    mean = float(weights @ (variance * share))
    scatter = math.sqrt(float(weights @ np.square(variance * share - mean)))
    weights *= variance
    A = view.A
    N, q, k = A.shape
    alone = float(weights @ (1.0 - share))
    smooth = np.zeros((k, k))
    flat = A.reshape(N, q * k)
    sizes = [float((weights * share)[place == i].sum()) for i in range(len(LENGTHS))]
    for length, size in zip(LENGTHS, sizes, strict=True):
        for first in range(0, N, _MOST):
            part = poses.take(np.arange(first, min(first + _MOST, N)))
            along = (part.alike(poses, length) @ flat).reshape(-1, k)
            smooth += size * A[first : first + _MOST].reshape(-1, k).T @ along
    smooth = 0.5 * (smooth + smooth.T)
    gained = np.einsum("q,nqi,nqj->ij", alone - learnt, A, A) + smooth
    spread = scatter / max(mean, 1e-300)
    return PoseErrors(
        np.asarray(gained),
        np.asarray(spread * smooth),
        SmoothErrors(
            tuple(map(tuple, poses.some().rows.tolist())),
            poses.mean_squares,
            LENGTHS,
            tuple(sizes),
            alone,
            tuple((np.maximum(alone + sum(sizes) - learnt, 0.0) * units**2).tolist()),
            spread,
        ),
    )


def along_base(view: Seen, R: Array) -> Seen:
    """With turns about the axes of the base: those of a body are R^T times these."""
    Q = np.broadcast_to(np.eye(6), (len(R), 6, 6)).copy()
    Q[:, 3:, 3:] = R
    y = np.einsum("nij,nj->ni", Q, view.y)
    return Seen(y, Q @ view.A, Q @ view.M @ np.swapaxes(Q, 1, 2))


def scaled(view: Seen, units: Array) -> Seen:
    """With errors in these units (q,)."""
    A, M = view.A * units[:, None], view.M * np.multiply.outer(units, units)
    return Seen(view.y * units, A, M)


def _usual_sds(problem: Problem) -> Array:
    """(6,) the sds of position and turns, 0 where they are learnt as that."""
    rows = [problem.mechanism.tape.quantities.index(q) for q in QUANTITIES]
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows]
    return np.asarray(np.median(sd, axis=1))


@dataclass(frozen=True, eq=False)
class Grid:
    """The likelihood of t, c and k, where poses show z (n, q) and B (n, q, k) = M^-1 A.

    poses (n,): which; pixels (q,): variances of z by pixels; H (k, k), g (k,): the information that
    is left, with the prior's.
    """

    poses: NDArray[np.intp]
    z: Array
    B: Array
    pixels: Array
    H: Array
    g: Array

    @classmethod
    def of(
        cls,
        pull: Array,
        equations: Sequence[PoseEquations],
        root: Array,
        view: Seen,
        learnt: Array,
    ) -> Grid | None:
        """None where hardly any image shows its pose."""
        values, vectors = np.linalg.eigh(view.M)
        inverse = (vectors / np.maximum(values, _LEAST)[:, None]) @ np.swapaxes(vectors, 1, 2)
        size = np.einsum("nqq->n", inverse)
        poses = np.flatnonzero(size <= _POOR * np.median(size))
        poses = poses[:: -(-len(poses) // _MOST)]
        pixels, axes = np.linalg.eigh(inverse[poses].mean(axis=0) - np.diag(learnt))
        z = np.einsum("nij,nj->ni", inverse, view.y)
        B = inverse @ view.A
        if len(poses) < 3 or not np.isfinite(B).all():
            return None
        H = np.eye(root.shape[1]) - np.einsum("nqi,nqj->ij", view.A, B)
        g = pull - np.einsum("nqi,nq->i", view.A, z)
        for block in equations:
            g += np.einsum("brk,br->k", rows_times(block.D, root), block.E)
        return cls(poses, z[poses] @ axes, axes.T @ B[poses], np.maximum(pixels, 0.0), H, g)

    def points(self, poses: StatedPoses) -> Array:
        """(g, 4) -2 log of the restricted likelihood, the length by position, c and t."""
        near = poses.take(self.poses)
        return np.array(
            [
                (criterion, i, share, variance)
                for i, length in enumerate(LENGTHS)
                for share, variance, criterion in self._over(near.alike(near, length), not i)
            ]
        )

    def _over(self, alike: Array, independent: bool) -> Iterator[tuple[float, float, float]]:
        """c, t and -2 log of the restricted likelihood, but for a constant."""
        along, vectors = np.linalg.eigh(alike)
        along = np.maximum(along, 0.0)
        z = vectors.T @ self.z
        n, q, k = self.B.shape
        B = (vectors.T @ self.B.reshape(n, q * k)).reshape(n * q, k)
        columns = np.column_stack([B, z.reshape(n * q)])
        for share in _SHARES if independent else _SHARES[1:]:
            for variance in _VARIANCES.tolist():
                v = variance * (1.0 - share + share * along)[:, None] + self.pixels
                products = (columns.T / v.ravel()) @ columns
                H, g = self.H + products[:k, :k], self.g + products[:k, k]
                square = float(products[k, k] - g @ np.linalg.solve(H, g))
                yield (
                    share,
                    variance,
                    float(np.log(v).sum()) + float(np.linalg.slogdet(H)[1]) + square,
                )
