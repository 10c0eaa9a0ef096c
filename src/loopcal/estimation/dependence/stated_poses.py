"""Poses that a robot states: how alike their errors are, and how far others are from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import SmoothErrors
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.parallel.free_body import COLUMNS, POSITION, TURNS
from loopcal.mechanisms.rotations import rotations

QUANTITIES = (*POSITION, *TURNS)

# docs/decisions/0161.
_TURN = 0.3
"""Weight w of turns beside distances, by the same arms as the lengths."""
# Chosen, not derived: the share that is known of an error hardly rises with more.
_SOME = 40
"""Poses that a result keeps, those farthest from each other."""


@dataclass(frozen=True, eq=False)
class StatedPoses:
    """rows (N, 7): x, y, z [m] and the quaternion w, x, y, z; mean_squares: of distance and of
    turn, over all pairs of the fit."""

    rows: Array
    mean_squares: tuple[float, float]

    @classmethod
    def of(cls, problem: Problem) -> StatedPoses | None:
        """Those of the flange of a robot without joints; None of anything else."""
        mechanism = problem.mechanism
        constants, names = [*mechanism.pose_constants], mechanism.tape.quantities
        stated = {*QUANTITIES} <= {*names} and {*COLUMNS} <= {*constants}
        if mechanism.joints or not stated or len(problem.poses) < 3:
            return None
        at = problem.readings[[names.index(q) for q in POSITION]]
        turned = problem.pose_constants[[constants.index(c) for c in COLUMNS]]
        bare = cls(np.vstack([at, turned]).T, (1.0, 1.0))
        # The mean square over all pairs is twice the variance; of n poses, n / (n - 1) times that.
        pairs = 2.0 * len(bare.rows) / (len(bare.rows) - 1.0)
        distance, turn = (
            max(pairs * float(v.reshape(len(v), -1).var(axis=0).sum()), 1e-12)
            for v in (bare.p, bare.R)
        )
        return replace(bare, mean_squares=(distance, turn))

    @property
    def p(self) -> Array:
        """(N, 3) [m]."""
        return self.rows[:, :3]

    @property
    def R(self) -> Array:
        """(N, 3, 3)."""
        return rotations(self.rows[:, 3:])

    def take(self, index: NDArray[np.intp]) -> StatedPoses:
        """Some of the poses, in the same units."""
        return replace(self, rows=self.rows[index])

    def some(self) -> StatedPoses:
        """Few of them: each the farthest from those before, from the middle on."""
        if len(self.rows) <= _SOME:
            return self
        points = self.points
        least = np.square(points - points.mean(axis=0)).sum(axis=1)
        chosen = [int(least.argmin())]
        least = np.full(len(points), np.inf)
        while len(chosen) < _SOME:
            least = np.minimum(least, np.square(points - points[chosen[-1]]).sum(axis=1))
            chosen.append(int(least.argmax()))
        return self.take(np.array(chosen))

    def alike(self, others: StatedPoses, length: float) -> Array:
        """(N, n) correlations k of errors with those of other poses."""
        a, b = self.points, others.points
        apart = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * a @ b.T
        return np.asarray(np.exp(-0.5 * np.maximum(apart, 0.0) / length**2))

    @property
    def points(self) -> Array:
        """(N, 12) whose distances are those of the poses, in the units of k."""
        distance, turn = ((1.0 + _TURN) * square for square in self.mean_squares)
        turned = np.sqrt(_TURN / turn) * self.R.reshape(-1, 9)
        return np.hstack([self.p / np.sqrt(distance), turned])


def unknown_share(smooth: SmoothErrors, rows: Array) -> Array:
    """(n,) of the variance of the smooth error of poses (n, 7): what the fit leaves unknown of it.

    By kriging (Krige 1951) the poses of the fit determine of the error of another one the share

        s = sum_l c_l k_l^T (K_l + a I)^-1 k_l,

    c the shares of the lengths, k the correlations with these poses, K those between them, a what
    each has by itself. Of their own errors they determine s_0, the median over each by all others:
    that much the learnt sds allow for. The share is 1 - s / s_0.

    Farther from their middle than they are (rms), it grows as the square of that distance: the
    parameters take up what is constant and linear, and what is left of a smooth function grows at
    least so.
    """
    fit = StatedPoses(np.array(smooth.poses), smooth.mean_squares)
    others = StatedPoses(rows, smooth.mean_squares)
    total = sum(smooth.sizes)
    if not total:
        return np.zeros(len(rows))
    alone = smooth.alone / total
    share, of_fit = np.zeros(len(rows)), np.zeros(len(fit.rows))
    for length, size in zip(smooth.lengths, smooth.sizes, strict=True):
        inverse = np.linalg.inv(fit.alike(fit, length) + alone * np.eye(len(fit.rows)))
        k = fit.alike(others, length)
        share += size / total * np.einsum("im,ij,jm->m", k, inverse, k, optimize=True)
        # What is left of an error by all others has the variance 1 / inverse_ii, its own share too.
        of_fit += size / total * (1.0 + alone - 1.0 / np.diag(inverse))
    unknown = np.clip(1.0 - share / max(float(np.median(of_fit)), 1e-12), 0.0, 1.0)
    middle = fit.points.mean(axis=0)
    near, far = (np.square(one.points - middle).sum(axis=1) for one in (fit, others))
    return np.asarray(np.maximum(1.0, far / near.mean()) * unknown)
