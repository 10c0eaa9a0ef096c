"""Arms of Universal Robots: their drawings, and any calibrated one as the six origins of its URDF.

    T_base_tip(q) = B  L_1 Rz(q_1)  L_2 Rz(q_2) ... L_6 Rz(q_6)  T

Of a Denavit-Hartenberg table L_i = Rx(alpha_i-1) Tx(a_i-1) Rz(theta_i) Tz(d_i). Where the axes of
shoulder, elbow and wrist are nearly parallel, d_2 and d_3 of a controller's table are hundreds of
metres. Where along its axis the frame of a joint lies, and how it is turned about it, changes
nothing: here each lies as near as it can to where the drawing puts it behind the one before.

The base B takes up what belongs to the place of the robot: axis 1, and the height and zero of
joint 1, as axis 2 shows them. The tool T takes up the zero of joint 6.
Sources of the drawings: the makers' published tables, `default_kinematics.yaml` of
Universal_Robots_ROS2_Description.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.mechanisms.rest import RestChain

Array = NDArray[np.float64]
QUARTER = 1.570796327
"""The right angle of the controller's tables."""
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
MODELS = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur20": (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    "ur30": (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
}
"""d_1, a_2, a_3, d_4, d_5 and d_6 [m]."""
# Calibrated arms lie within millimetres of their drawing; farther away is another machine.
_NEAR = 0.05
"""[m, 1] by which the entries of an origin may differ from the drawing's."""


@dataclass(frozen=True)
class UrTable:
    """theta, d, a and alpha of the six joints [rad, m], as the controller holds them."""

    theta: tuple[float, ...]
    d: tuple[float, ...]
    a: tuple[float, ...]
    alpha: tuple[float, ...]

    def changed(self, deltas: Mapping[str, Sequence[float]]) -> UrTable:
        """With theta, d, a and alpha changed by these."""
        return UrTable(
            *(
                tuple(float(v + d) for v, d in zip(getattr(self, key), deltas[key], strict=True))
                for key in ("theta", "d", "a", "alpha")
            )
        )

    @property
    def steps(self) -> tuple[Step, ...]:
        """The arm as elementary steps; its joints are called by the links of `LINKS`."""
        return tuple(
            step
            for link, theta, d, a, alpha in zip(
                LINKS, self.theta, self.d, self.a, self.alpha, strict=True
            )
            for step in (
                Step("rz", joint=link, constant=theta),
                Step("tz", constant=d),
                Step("tx", constant=a),
                Step("rx", constant=alpha),
            )
        )


def drawing(model: str) -> UrTable:
    """The table of a model as drawn."""
    d1, a2, a3, d4, d5, d6 = MODELS[model]
    return UrTable(
        (0.0,) * 6,
        (d1, 0.0, 0.0, d4, d5, d6),
        (0.0, a2, a3, 0.0, 0.0, 0.0),
        (QUARTER, 0.0, 0.0, QUARTER, -QUARTER, 0.0),
    )


@dataclass(frozen=True, eq=False)
class UrOrigins:
    """model: whose drawing the arm is near; origins: L (4, 4) by link; base, tool: B and T."""

    model: str
    origins: Mapping[str, Array]
    base: Array
    tool: Array

    def pose(self, readings: Sequence[float]) -> Array:
        """T_base_tip (4, 4) at six readings [rad]."""
        T = self.base
        for L, q in zip(self.origins.values(), readings, strict=True):
            T = T @ L @ product([Step("rz", constant=float(q))], {}, {})
        return T @ self.tool


def ur_origins(chain: RestChain) -> UrOrigins:
    """A calibrated arm as the origins of the model that it is nearest to.

    Raises InputError for an arm that is none of these.
    """
    joints = chain.joints
    turning = [j for j in joints if j.kind == "revolute" and abs(j.factor) == 1.0]
    if len(joints) != 6 or len(turning) != 6 or len({j.reads for j in joints}) != 6:
        raise _no_ur("it does not have six turning joints")
    fits = [_placed(chain.along_z, model) for model in MODELS]
    errors = [_away(one) for one in fits]
    best = int(np.argmin(errors))
    if errors[best] > _NEAR:
        raise _no_ur(
            f"it is nearest to the {fits[best].model}, from which an entry of an origin differs "
            f"by {errors[best]:.3g} (m or rad)"
        )
    return fits[best]


def _no_ur(words: str) -> InputError:
    return InputError(
        f"this arm is not one of Universal Robots: {words}",
        code="unsupported",
        remedy="check the signs and zeros of the joints, or use the format of another maker",
    )


def nominal_origins(model: str) -> list[Array]:
    """L_1 ... L_6 (4, 4) of a drawing."""
    table = drawing(model)
    ahead, origins = np.eye(4), []
    for theta, d, a, alpha in zip(table.theta, table.d, table.a, table.alpha, strict=True):
        origins.append(
            ahead @ product([Step("rz", constant=theta), Step("tz", constant=d)], {}, {})
        )
        ahead = product([Step("tx", constant=a), Step("rx", constant=alpha)], {}, {})
    return origins


def _away(arm: UrOrigins) -> float:
    nominal = nominal_origins(arm.model)
    pairs = zip(arm.origins.values(), nominal, strict=True)
    return max(float(np.abs(L - N).max()) for L, N in pairs)


def _placed(chain: RestChain, model: str) -> UrOrigins:
    """The frames of a chain, whose axes are along z, near those of a drawing."""
    axes, T = [], np.eye(4)
    for joint in chain.joints:
        T = T @ joint.before
        axes.append(T)
    tip = T @ chain.tip
    nominal = nominal_origins(model)
    base = _base(axes[0], axes[1], MODELS[model][0])
    origins, before = {}, base
    for link, axis, N in zip(LINKS, axes, nominal, strict=True):
        frame = _onto(axis, before @ N)
        origins[link] = inverse(before) @ frame
        before = frame
    return UrOrigins(model, origins, base, inverse(before) @ tip)


def _base(first: Array, second: Array, height: float) -> Array:
    """B: its z along axis 1, its -y towards axis 2, below where axis 2 comes nearest."""
    z, along = first[:3, 2], second[:3, 2]
    across = along - z * (z @ along)
    y = -across / (float(np.linalg.norm(across)) or 1.0)
    x = np.cross(y, z)
    between = second[:3, 3] - first[:3, 3]
    # the point of axis 1 that is nearest to axis 2
    # Shortest distance of two lines: the foot on axis 1 has its connection normal to both axes.
    square = float(across @ across) or 1.0
    s = float(between @ z) - float(between @ across) * float(along @ z) / square
    foot = first[:3, 3] + s * z
    return rigid(np.stack([x, y, z], axis=1), foot - height * z)


def _onto(axis: Array, near: Array) -> Array:
    """The frame with this axis as z that comes nearest to another."""
    z, o = axis[:3, 2], axis[:3, 3]
    x = near[:3, 0] - z * (z @ near[:3, 0])
    x = x / (float(np.linalg.norm(x)) or 1.0)
    origin = o + z * float(z @ (near[:3, 3] - o))
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), origin)
