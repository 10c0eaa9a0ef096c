"""The pose of an arm's tool, and how it moves with joints and parameters, for many poses at once.

A tape gives four points of the body: the tool's own point t, and b, b + e_x, b + e_y of its frame.
From these follow the pose (t, R R_tool) and, from their derivatives, its twists

    v = dt,    w = 1/2 sum_i r_i x dr_i,    r_i the columns of R.

The same holds for the calibrated machine, whose body sags, and for the model of a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.rigid import crossing
from loopcal.expressions.engine import Stage, engine_for
from loopcal.expressions.tape import Tape
from loopcal.mechanisms.placement import inverse, rigid

Array = NDArray[np.float64]
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class ArmPose:
    """T(q) of a tool in the base of its arm.

    tape: values of the points (12) [m] where its readings are zero but for the joints; parameters:
    (n_all,) [SI]; joints: their names; known: constants of every pose, name -> value [SI]; base:
    (4, 4) of the arm's base in the frame of the tape; tool: (3, 3) R_tool.
    """

    tape: Tape
    parameters: Array
    joints: tuple[str, ...]
    constants: Mapping[str, float]
    base: Array
    tool: Array

    def __call__(self, q: Array) -> Array:
        """(N, 4, 4) at joints q (N, n) [rad, m]."""
        points, _, _ = self._points(q, (), Stage.VALUES)
        t, R = _frame(points)
        return inverse(self.base) @ rigid(R @ self.tool, t)

    def tool_on_body(self) -> Array:
        """(3,) where the tool's point is on the body, after the last change along the run [m]."""
        points, _, _ = self._points(np.zeros((1, len(self.joints))), (), Stage.VALUES)
        t, R = _frame(points)
        on_body: Array = R[0].T @ (t[0] - points[0, 3:6])
        return on_body

    def moving(self, q: Array) -> tuple[Array, Array]:
        """(N, 4, 4) at joints q (N, n), and (N, 6, n) the twists by the joints."""
        points, by_joint, _ = self._points(q, (), Stage.BY_QUANTITY)
        t, R = _frame(points)
        T = inverse(self.base) @ rigid(R @ self.tool, t)
        return T, _twist(R, by_joint, self.base[:3, :3].T)

    def twists(self, q: Array, names: Sequence[str] = ()) -> tuple[Array, Array]:
        """(N, 6, n) by the joints and (N, 6, p) by the named parameters, in the arm's base."""
        stage = Stage.BY_PARAMETER if names else Stage.BY_QUANTITY
        points, by_joint, by_parameter = self._points(q, tuple(names), stage)
        _, R = _frame(points)
        turn = self.base[:3, :3].T
        return _twist(R, by_joint, turn), _twist(R, by_parameter, turn)

    def _points(self, q: Array, names: tuple[str, ...], stage: Stage) -> tuple[Array, Array, Array]:
        """(N, 12) points, (N, 12, n) by joints, (N, 12, p) by parameters."""
        quantities = self.tape.quantities
        rows = [quantities.index(joint) for joint in self.joints]
        engine = engine_for(self.tape, names, min(_BLOCK, max(len(q), 1)), self.joints)
        constants = np.array([self.constants[name] for name in self.tape.pose_constants])
        points = np.empty((len(q), 12))
        by_joint = np.empty((len(q), 12, len(self.joints)))
        by_parameter = np.empty((len(q), 12, len(names)))
        for begin in range(0, len(q), _BLOCK):
            part = slice(begin, min(begin + _BLOCK, len(q)))
            x = np.zeros((len(quantities), len(q[part])))
            x[rows] = q[part].T
            by_pose = np.broadcast_to(constants[:, None], (len(constants), x.shape[1]))
            values = engine.evaluate(self.parameters, x, np.ascontiguousarray(by_pose), stage)
            points[part] = values.f.T
            if stage >= Stage.BY_QUANTITY:
                by_joint[part] = values.by_quantity.transpose(2, 1, 0)
            if stage >= Stage.BY_PARAMETER:
                by_parameter[part] = values.by_parameter.transpose(2, 1, 0)
        return points, by_joint, by_parameter


def _frame(points: Array) -> tuple[Array, Array]:
    """The tool's point (N, 3) and R (N, 3, 3): the rotation nearest to the axes that are given.

    Of M = [x y], M (M^T M)^-1/2, the root of a matrix of 2 rows by its trace and determinant.
    """
    b = points[:, 3:6]
    x, y = points[:, 6:9] - b, points[:, 9:12] - b
    xx, xy, yy = (np.einsum("ni,ni->n", u, v)[:, None] for u, v in ((x, x), (x, y), (y, y)))
    root = np.sqrt(xx * yy - xy * xy)
    scale = root * np.sqrt(xx + yy + 2.0 * root)
    x, y = ((yy + root) * x - xy * y) / scale, ((xx + root) * y - xy * x) / scale
    z = np.einsum("nij,nj->ni", crossing(x), y)
    return points[:, :3], np.stack([x, y, z], axis=-1)


def _twist(R: Array, by: Array, turn: Array) -> Array:
    """(N, 6, n) twists of derivatives (N, 12, n) of the points, turned into the arm's base."""
    dx, dy = (by[:, i : i + 3] - by[:, 3:6] for i in (6, 9))
    X, Y, Z = (crossing(R[:, :, i]) for i in range(3))
    # dz = dx x y + x x dy
    w = 0.5 * ((X - Z @ Y) @ dx + (Y + Z @ X) @ dy)
    both: Array = np.concatenate([turn @ by[:, :3], turn @ w], axis=1)
    return both
