"""pyceres with Python cost functions: the joints of every pose one block, the parameters another.

Ceres eliminates the joints by a Schur complement (it finds them by itself, its Python interface has
no ordering), and has a prior in C++ for them. The point is a callback per pose in plain Python,
since Ceres asks for one pose at a time; what it asks for twice, first without derivatives, is kept.
These callbacks dominate: at 1,000 poses of the six-axis arm they are nine tenths of the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyceres
from chain import Chain, Pose, one_pose
from numpy.typing import NDArray
from problems import Fit, Problem

Array = NDArray[np.float64]
TOLERANCE = 1e-11
"""Of chi-squared: the least relative change that is worth another step."""


class Point(pyceres.CostFunction):  # type: ignore[misc] # has no types
    """The point of one pose beside the one that was measured, (P,), in sds."""

    def __init__(self, chain: Chain, measured: Array, sds: Array, sizes: list[int]) -> None:
        super().__init__()
        self.set_num_residuals(len(measured))
        self.set_parameter_block_sizes(sizes)
        self.chain, self.measured, self.sds = chain, measured, sds
        self.at: tuple[list[float], list[float]] | None = None
        self.pose: Pose

    def Evaluate(self, parameters: list[Array], residuals: Array, jacobians: Any) -> bool:
        """Write residuals and, where asked for, derivatives row by row."""
        at = (parameters[0].tolist(), parameters[1].tolist())
        if at != self.at:
            self.at, self.pose = at, one_pose(self.chain, *at)
        m = len(self.sds)
        residuals[:] = (self.pose.point[:m] - self.measured) / self.sds
        if jacobians is not None:
            found = (self.pose.by_joint, self.pose.by_parameter)
            for wanted, columns in zip(jacobians, found, strict=True):
                wanted[:] = (np.array(columns)[:, :m] / self.sds).T.ravel()
        return True


class Enough(pyceres.IterationCallback):  # type: ignore[misc] # nor has this
    """Ends after a step that changed hardly anything; by its own test Ceres would not take it."""

    def __call__(self, summary: Any) -> Any:
        """After every iteration; the first of them is the start."""
        enough = summary.iteration > 0 and abs(summary.cost_change) <= TOLERANCE * summary.cost
        answers = pyceres.CallbackReturnType
        return answers.SOLVER_TERMINATE_SUCCESSFULLY if enough else answers.SOLVER_CONTINUE


def calibrate(problem: Problem) -> Fit:
    """The fit; raises RuntimeError where Ceres does not converge."""
    parameters, joints = problem.nominal.copy(), list(problem.joints.T.copy())
    sizes, covariance = [len(problem.joints), len(parameters)], np.diag(problem.joint_sds**2)
    costs, whole = [], pyceres.Problem()
    for own, measured in zip(joints, problem.points.T, strict=True):
        prior = pyceres.factors.NormalPrior(own, covariance)
        point = Point(problem.model.chain, measured, problem.point_sds, sizes)
        whole.add_residual_block(prior, None, [own])
        whole.add_residual_block(point, None, [own, parameters])
        costs += [prior, point]  # Ceres does not keep them alive
    options, enough = pyceres.SolverOptions(), Enough()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.initial_trust_region_radius = 1e16  # nominal values are near: begin undamped
    options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 0.0
    options.callbacks = [enough]
    summary = pyceres.SolverSummary()
    pyceres.solve(options, whole, summary)
    ends = pyceres.TerminationType
    if summary.termination_type not in (ends.USER_SUCCESS, ends.CONVERGENCE):
        raise RuntimeError(f"Ceres did not converge: {summary.message}")
    evaluations = summary.num_residual_evaluations + 2 * summary.num_jacobian_evaluations
    return Fit(parameters, 2 * summary.final_cost, evaluations)
