"""The seed's program as NumPy has it when written pose by pose: section 3 of the method.

The forward transform of each pose is a product of 4x4 matrices, each derivative that product
with one matrix replaced by its derivative (products from the left and from the right are kept,
so that none is formed twice); then QR and triangular solves per pose and one least-squares
solution per iteration. Nothing is vectorised over poses, as in the original.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
from chain import Chain
from numpy.typing import NDArray
from problems import Fit, Problem
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]
MOST = 100


def translation(axis: int, amount: float) -> Array:
    """The 4x4 matrix of a move along a coordinate axis."""
    T = np.eye(4)
    T[axis, 3] = amount
    return T


def rotation(axis: int, angle: float) -> Array:
    """The 4x4 matrix of a turn about a coordinate axis."""
    c, s = cos(angle), sin(angle)
    if axis == 0:
        return np.array([[1.0, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
    if axis == 1:
        return np.array([[c, 0.0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return np.array([[c, -s, 0.0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def _generator(kind: str, axis: int) -> Array:
    """The derivative of an elementary transform is the transform times this matrix."""
    if kind == "t":
        return translation(axis, 1.0) - np.eye(4)
    step = rotation(axis, np.pi / 2) - np.eye(4)
    step[np.diag_indices(4)] = 0.0
    return step


GENERATORS = {kind: [_generator(kind, axis) for axis in range(3)] for kind in "tr"}
MATRIX = {"t": translation, "r": rotation}


def linearised(chain: Chain, theta: Array, p: Array) -> tuple[Array, Array, Array]:
    """Point (3,) of one pose, its derivatives by the joints (3, J) and the parameters (3, n)."""
    matrices = []
    left = [np.eye(4)]
    for factor in chain.factors:
        i = factor.parameter
        amount = factor.sign * float(theta[factor.joint]) if i is None else float(p[i])
        matrices.append(MATRIX[factor.kind](factor.axis, amount))
        left.append(left[-1] @ matrices[-1])
    J_x, J_p = np.empty((3, theta.size)), np.empty((3, p.size))
    right = np.array([0.0, 0.0, 0.0, 1.0])
    for axis, parameter in enumerate(chain.tip):
        right[axis] = p[parameter]
        J_p[:, parameter] = left[-1][:3, axis]
    for i in range(len(matrices) - 1, -1, -1):
        factor = chain.factors[i]
        column = (left[i + 1] @ (GENERATORS[factor.kind][factor.axis] @ right))[:3]
        if factor.parameter is not None:
            J_p[:, factor.parameter] = column
        else:
            J_x[:, factor.joint] = factor.sign * column
        right = matrices[i] @ right
    return right[:3], J_x, J_p


def calibrate(problem: Problem, tolerance: float = 1e-6) -> Fit:
    """The seed's iteration (3.24) to (3.30) with flat priors, until no parameter moves any more.

    tolerance: of a parameter's move beside its sd.
    """
    joints, points, sds, chain = problem.joints, problem.points, problem.sds, problem.model.chain
    (J, N), m, n = joints.shape, len(points), problem.nominal.size
    p = problem.nominal
    y = np.zeros((N, J + m))
    for iteration in range(1, MOST + 1):
        D, E, Q_all = np.empty((N, m, n)), np.empty((N, m)), np.empty((N, J + m, m))
        for i in range(N):
            corrected = sds * y[i]
            point, J_theta, J_p = linearised(chain, joints[:, i] + corrected[:J], p)
            f = point[:m] - (points[:, i] + corrected[J:])
            J_y = np.hstack([J_theta[:m], -np.eye(m)]) * sds
            Q, R = np.linalg.qr(J_y.T)
            D[i] = solve_triangular(R, J_p[:m], trans="T")
            E[i] = Q.T @ y[i] - solve_triangular(R, f, trans="T")
            Q_all[i] = Q
        stacked = D.reshape(-1, n)
        step, *_ = np.linalg.lstsq(stacked, E.reshape(-1), rcond=None)
        for i in range(N):
            y[i] = Q_all[i] @ (E[i] - D[i] @ step)
        p = p + step
        sd = np.sqrt(np.diag(np.linalg.inv(stacked.T @ stacked)))
        if np.abs(step / sd).max() <= tolerance:
            return Fit(p, float(np.square(y).sum()), float(iteration))
    raise RuntimeError("the seed's program did not converge")
