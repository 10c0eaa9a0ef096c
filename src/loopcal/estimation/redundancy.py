"""How well the other readings control each reading, and chi-squared beside it.

With the whitened equations E = D dp + v of a pose, x_j the effect of reading j on them (its column
of X) and W = I - D C D^T, C the covariance of the parameters,

    r_j = (Sigma X^T W X)_jj,   q_j = c_j (Sigma^-1 c)_j = c_j x_j^T E,   E q_j = r_j,

c the corrections of the readings (Foerstner 1979, Ein Verfahren zur Schaetzung von Varianz- und
Kovarianzkomponenten). The redundancy numbers r_j add up to the degrees of freedom: a reading with
r_j near 0 is what the fit makes of it, one near 1 is known from the others. So a sensor is judged
by its sum of q_j over its sum of r_j, which is 1 where its sd is right, whatever its weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times

# Its square root: a gross error of 1000 sds shows by one sd. Chosen, not derived.
UNCONTROLLED = 1e-6
"""A reading that the others control to less than this share cannot be tested."""


@dataclass(frozen=True)
class Redundancy:
    """Of each reading (k, N), NaN where it was not measured.

    numbers: r_j; squares: q_j; power: x_j^T W x_j [1/SI^2], what the others leave to test of it.
    """

    numbers: Array
    squares: Array
    power: Array


def redundancy(
    problem: Problem, equations: tuple[PoseEquations, ...], covariance: Array
) -> Redundancy:
    """Of all readings that took part in a fit; covariance: (n, n) of its parameters."""
    shape = problem.readings.shape
    numbers, squares, power = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    sd = np.broadcast_to(problem.uncertainty.sd, shape)
    variance = np.where(np.isfinite(sd), np.square(sd), 0.0)
    for block in equations:
        poses = block.poses
        spread = rows_times(block.D, covariance) @ block.D.transpose(0, 2, 1)
        WX = block.X - spread @ block.X
        left = np.einsum("brk,brk->bk", block.X, WX)
        if block.beside is not None:
            left += block.beside.squares
        seen = np.einsum("brk,br->bk", block.X, block.E)
        shares, corrections = variance.T[poses] * left, variance.T[poses] * seen
        for joint in problem.uncertainty.of(poses).blocks:
            rows = list(joint.indices)
            matrix = joint.factor @ np.swapaxes(joint.factor, -1, -2)
            inner = block.X[:, :, rows].transpose(0, 2, 1) @ WX[:, :, rows]
            # A covariance is one for all poses, or each has its own.
            shares[:, rows] = (matrix * np.swapaxes(inner, 1, 2)).sum(axis=2)
            corrections[:, rows] = (matrix @ seen[:, rows, None])[..., 0]
        power[:, poses], numbers[:, poses] = left.T, shares.T
        squares[:, poses] = (corrections * seen).T
    lost = np.isinf(sd)
    return Redundancy(*(np.where(lost, np.nan, part) for part in (numbers, squares, power)))
