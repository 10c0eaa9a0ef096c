"""The seed's program as NumPy has it when written pose by pose: section 3 of the method.

The forward transform of each pose is a product of 4x4 matrices, each derivative that product
with one matrix replaced by its derivative (products from the left and from the right are kept,
so that none is formed twice); then QR and triangular solves per pose and one least-squares
solution per iteration. Nothing is vectorised over poses, as in the original. The planar arm
has its equations written out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from geometric_arm import AXES, DIRECTIONS, PLANES
from numpy.typing import NDArray
from problems import Fit, Problem
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]
MOST = 100


def translation(axis: str, amount: float) -> Array:
    """The 4x4 matrix of a move along a coordinate axis."""
    T = np.eye(4)
    T["xyz".index(axis), 3] = amount
    return T


def rotation(axis: str, angle: float) -> Array:
    """The 4x4 matrix of a turn about a coordinate axis."""
    c, s = cos(angle), sin(angle)
    if axis == "x":
        return np.array([[1.0, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
    if axis == "y":
        return np.array([[c, 0.0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return np.array([[c, -s, 0.0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def _generator(kind: str, axis: str) -> Array:
    """The derivative of an elementary transform is the transform times this matrix."""
    if kind == "t":
        return translation(axis, 1.0) - np.eye(4)
    step = rotation(axis, np.pi / 2) - np.eye(4)
    step[np.diag_indices(4)] = 0.0
    return step


@dataclass(frozen=True)
class Elementary:
    """One factor of the chain: a move "t" or turn "r" by a parameter, or by a joint's reading."""

    kind: str
    axis: str
    parameter: int | None
    joint: int = -1

    def amount(self, theta: Array, p: Array) -> float:
        """By how much, for joints (6,) and parameters (27,)."""
        if self.parameter is not None:
            return float(p[self.parameter])
        return DIRECTIONS[self.joint] * float(theta[self.joint])

    def matrix(self, amount: float) -> Array:
        """The 4x4 matrix."""
        return translation(self.axis, amount) if self.kind == "t" else rotation(self.axis, amount)


def elementary() -> list[Elementary]:
    """The chain: Tx Ty Rx Ry Rz, Tx Tz Rx Rz Ry, ..."""
    chain = []
    for joint, axis in enumerate(AXES):
        a, b = tuple(PLANES[axis])
        first = 4 * joint
        chain += [Elementary("t", a, first), Elementary("t", b, first + 1)]
        chain += [Elementary("r", a, first + 2), Elementary("r", b, first + 3)]
        chain.append(Elementary("r", axis, None, joint))
    return chain


CHAIN = elementary()
GENERATORS = [_generator(step.kind, step.axis) for step in CHAIN]


def chain(theta: Array, p: Array) -> tuple[Array, Array, Array]:
    """Six axes: point (3,) of one pose, derivatives by joints (3, 6) and parameters (3, 27)."""
    matrices = [step.matrix(step.amount(theta, p)) for step in CHAIN]
    left = [np.eye(4)]
    for T in matrices:
        left.append(left[-1] @ T)
    J_x, J_p = np.empty((3, 6)), np.empty((3, 27))
    J_p[:, 24:] = left[-1][:3, :3]
    right = np.array([p[24], p[25], p[26], 1.0])
    for i in range(len(CHAIN) - 1, -1, -1):
        step = CHAIN[i]
        column = (left[i + 1] @ (GENERATORS[i] @ right))[:3]
        if step.parameter is not None:
            J_p[:, step.parameter] = column
        else:
            J_x[:, step.joint] = DIRECTIONS[step.joint] * column
        right = matrices[i] @ right
    return right[:3], J_x, J_p


def two_links(theta: Array, p: Array) -> tuple[Array, Array, Array]:
    """Planar: point (2,) of one pose, derivatives by joints (2, 2) and parameters (2, 6)."""
    a = theta[0] + p[4]
    b = a + theta[1] + p[5]
    ca, sa, cb, sb = cos(a), sin(a), cos(b), sin(b)
    x, y = p[2] * ca + p[3] * cb, p[2] * sa + p[3] * sb
    J_x = np.array([[-y, -p[3] * sb], [x, p[3] * cb]])
    J_p = np.array([[1.0, 0.0, ca, cb, -y, -p[3] * sb], [0.0, 1.0, sa, sb, x, p[3] * cb]])
    return np.array([p[0] + x, p[1] + y]), J_x, J_p


LINEARISED = {"six-axis": chain, "planar": two_links}


def calibrate(problem: Problem, tolerance: float = 1e-6) -> Fit:
    """The seed's iteration (3.24) to (3.30) with flat priors, until no parameter moves any more.

    tolerance: of a parameter's move beside its sd.
    """
    joints, points, sds = problem.joints, problem.points, problem.sds
    (J, N), P, n = joints.shape, len(points), problem.nominal.size
    p, linearised, by_point = problem.nominal, LINEARISED[problem.name], -np.eye(P)
    y = np.zeros((N, J + P))
    for iteration in range(1, MOST + 1):
        D, E, Q_all = np.empty((N, P, n)), np.empty((N, P)), np.empty((N, J + P, P))
        for i in range(N):
            corrected = sds * y[i]
            point, J_theta, J_p = linearised(joints[:, i] + corrected[:J], p)
            f = point - (points[:, i] + corrected[J:])
            J_y = np.hstack([J_theta, by_point]) * sds
            Q, R = np.linalg.qr(J_y.T)
            D[i] = solve_triangular(R, J_p, trans="T")
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
