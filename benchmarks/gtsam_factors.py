"""gtsam with Python factors: a prior on the joints of every pose, and a factor of its own there.

The model is evaluated for all poses at once, ahead of each linearisation; a factor only hands over
its part of it. Gauss-Newton is a loop here, because gtsam's own optimizer passes every factor a
copy of all variables, and its time grows with the square of the number of poses; that of Values
held by Python it does not copy. The parameters are eliminated last, as arrow matrices want it.
At 1,000 poses of the six-axis arm callbacks and what gtsam does around them take two fifths of the
time, elimination a third, the model a fifth. With a factor that evaluates its own pose in plain
Python, callbacks dominate and the whole takes twice as long.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from problems import Fit, Problem

Array = NDArray[np.float64]
TOLERANCE, MOST = 1e-11, 100
"""Of chi-squared: the least relative decrease that is worth another step; and of steps."""


class Poses:
    """The misfit and its derivatives in all poses, where the factors find theirs."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.parameters = gtsam.symbol("p", 0)
        self.joints = [gtsam.symbol("x", i) for i in range(problem.joints.shape[1])]

    def at(self, values: gtsam.Values) -> None:
        """Evaluate the model there: misfit (N, P), derivatives (N, J, P) and (N, n, P)."""
        model, p = self.problem.model, values.atVector(self.parameters)
        joints = np.array([values.atVector(key) for key in self.joints]).T
        self.misfit = (model.point(joints, p) - self.problem.points).T.copy()
        self.by_joint = model.by_joint(joints, p).T.copy()
        self.by_parameter = model.by_parameter(joints, p).T.copy()

    def factor(self, i: int, factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        """The part of pose i, as gtsam asks for it."""
        if jacobians is not None:
            jacobians[0], jacobians[1] = self.by_joint[i].T, self.by_parameter[i].T
        misfit: Array = self.misfit[i]
        return misfit


def calibrate(problem: Problem) -> Fit:
    """The fit; raises RuntimeError where it does not converge."""
    poses = Poses(problem)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    of_joints = gtsam.noiseModel.Diagonal.Sigmas(problem.joint_sds)
    of_point = gtsam.noiseModel.Diagonal.Sigmas(problem.point_sds)
    ordering = gtsam.Ordering()
    values.insert(poses.parameters, problem.nominal)
    for i, (key, read) in enumerate(zip(poses.joints, problem.joints.T.copy(), strict=True)):
        values.insert(key, read)
        graph.add(gtsam.PriorFactorVector(key, read, of_joints))
        keys = [key, poses.parameters]
        graph.add(gtsam.CustomFactor(of_point, keys, partial(poses.factor, i)))
        ordering.push_back(key)
    ordering.push_back(poses.parameters)
    zero = values.zeroVectors()
    for step in range(1, MOST + 1):
        poses.at(values)
        linear = graph.linearize(values)
        move = linear.optimize(ordering)
        before, after = linear.error(zero), linear.error(move)
        values = values.retract(move)
        if before - after <= TOLERANCE * before:
            poses.at(values)
            return Fit(values.atVector(poses.parameters), 2 * graph.error(values), 3 * step + 3)
    raise RuntimeError("gtsam did not converge")
