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

from loopcal.deployment.rigid import inverse, pose
from loopcal.expressions.engine import Stage, engine_for
from loopcal.expressions.tape import Tape

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
    known: Mapping[str, float]
    base: Array
    tool: Array

    def __call__(self, q: Array) -> Array:
        """(N, 4, 4) at joints q (N, n) [rad, m]."""
        points, _, _ = self._points(q, (), Stage.VALUES)
        t, R = _frame(points)
        return inverse(self.base) @ pose(R @ self.tool, t)

    def tool_on_body(self) -> Array:
        """(3,) where the tool's point is on the body, after the last change along the run [m]."""
        points, _, _ = self._points(np.zeros((1, len(self.joints))), (), Stage.VALUES)
        t, R = _frame(points)
        found: Array = R[0].T @ (t[0] - points[0, 3:6])
        return found

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
        engine.at(self.parameters)
        constants = np.array([self.known[name] for name in self.tape.known])
        points = np.empty((len(q), 12))
        by_joint = np.empty((len(q), 12, len(self.joints)))
        by_parameter = np.empty((len(q), 12, len(names)))
        for begin in range(0, len(q), _BLOCK):
            part = slice(begin, min(begin + _BLOCK, len(q)))
            x = np.zeros((len(quantities), len(q[part])))
            x[rows] = q[part].T
            known = np.broadcast_to(constants[:, None], (len(constants), x.shape[1]))
            found = engine.evaluate(x, np.ascontiguousarray(known), stage)
            points[part] = found.f.T
            if stage >= Stage.BY_QUANTITY:
                by_joint[part] = found.by_quantity.transpose(2, 1, 0)
            if stage >= Stage.BY_PARAMETER:
                by_parameter[part] = found.by_parameter.transpose(2, 1, 0)
        return points, by_joint, by_parameter


def _frame(points: Array) -> tuple[Array, Array]:
    """The tool's point (N, 3) and R (N, 3, 3): the rotation nearest to the axes that are given."""
    b = points[:, 3:6]
    x, y = points[:, 6:9] - b, points[:, 9:12] - b
    U, _, V = np.linalg.svd(np.stack([x, y, np.cross(x, y)], axis=-1))
    return points[:, :3], U @ V


def _twist(R: Array, by: Array, turn: Array) -> Array:
    """(N, 6, n) twists of derivatives (N, 12, n) of the points, turned into the arm's base."""
    dx, dy = (by[:, i : i + 3] - by[:, 3:6] for i in (6, 9))
    x, y = R[:, :, 0, None], R[:, :, 1, None]
    dz = np.cross(dx, y, axis=1) + np.cross(x, dy, axis=1)
    w = 0.5 * sum(np.cross(R[:, :, i, None], d, axis=1) for i, d in enumerate((dx, dy, dz)))
    both: Array = np.concatenate([turn @ by[:, :3], turn @ w], axis=1)
    return both
