"""scipy's least_squares: parameters and the true joints of every pose are its unknowns.

Method "trf" with LSMR, since only that takes a sparse Jacobian ("lm" and exact steps are dense);
columns scaled by the Jacobian, no damping, LSMR to the end: with its looser default, steps are so
poor that hundreds of them do not converge. The Jacobian is analytic, its pattern written once.
At 1,000 poses of the six-axis arm nine tenths of the time are LSMR's 250 iterations per step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from problems import Fit, Problem
from scipy.optimize import least_squares
from scipy.sparse import csr_array

Array = NDArray[np.float64]
TO_THE_END = {"atol": 1e-13, "btol": 1e-13, "conlim": 0.0, "maxiter": 2_000, "regularize": False}


class Residuals:
    """Points and joints beside their readings, in sds; unknowns: parameters, then joints by pose.

    A row of a point depends on all parameters and the joints of its pose, of a joint on itself.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        (J, N), P, n = problem.joints.shape, len(problem.points), problem.nominal.size
        own = np.broadcast_to(n + np.arange(N * J).reshape(N, 1, J), (N, P, J))
        shared = np.broadcast_to(np.arange(n), (N, P, n))
        of_points = np.concatenate([shared, own], axis=2).ravel()
        lengths = np.concatenate([np.full(N * P, n + J), np.ones(N * J, dtype=int)])
        self.columns = np.concatenate([of_points, n + np.arange(N * J)]).astype(np.int32)
        self.rows = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        self.of_joints = np.tile(1 / problem.joint_sds, N)
        self.start = np.concatenate([problem.nominal, problem.joints.T.ravel()])

    def _split(self, unknowns: Array) -> tuple[Array, Array]:
        """Parameters (n,) and joints (J, N)."""
        p, joints = np.split(unknowns, [self.problem.nominal.size])
        return p, joints.reshape(-1, len(self.problem.joints)).T

    def __call__(self, unknowns: Array) -> Array:
        """All residuals, the points' first."""
        problem, (p, joints) = self.problem, self._split(unknowns)
        points = (problem.model.point(joints, p) - problem.points) / problem.point_sds[:, None]
        moved = (joints - problem.joints) / problem.joint_sds[:, None]
        return np.concatenate([points.T.ravel(), moved.T.ravel()])

    def jacobian(self, unknowns: Array) -> csr_array:
        """Their derivatives."""
        model, (p, joints) = self.problem.model, self._split(unknowns)
        wide = np.concatenate([model.by_parameter(joints, p), model.by_joint(joints, p)], axis=1)
        of_points = (wide / self.problem.point_sds[:, None, None]).transpose(2, 0, 1).ravel()
        entries = np.concatenate([of_points, self.of_joints])
        shape = (len(self.rows) - 1, unknowns.size)
        return csr_array((entries, self.columns, self.rows), shape=shape)


def calibrate(problem: Problem) -> Fit:
    """The fit; raises RuntimeError where scipy does not converge."""
    residuals = Residuals(problem)
    found = least_squares(
        residuals,
        residuals.start,
        jac=residuals.jacobian,
        x_scale="jac",
        tr_solver="lsmr",
        tr_options=TO_THE_END,
        ftol=1e-11,
        xtol=None,
        gtol=None,
        max_nfev=100,
    )
    if not found.success:
        raise RuntimeError(f"least_squares did not converge: {found.message}")
    evaluations = float(found.nfev + 2 * found.njev)
    return Fit(found.x[: problem.nominal.size], 2 * float(found.cost), evaluations)
