"""Any chain of joints in the parameters of Denavit and Hartenberg, classical and modified.

    classical:  T_base_tip = B  Rz(theta_1) Tz(d_1) Tx(a_1) Rx(alpha_1)  Rz(theta_2) ...  T
    modified:   T_base_tip = B  Rz(theta_1) Tz(d_1)  Rx(alpha_1) Tx(a_1) Rz(theta_2) ...  T

with theta_i = offset_i + factor_i q_i (of a slide d_i = offset_i + factor_i q_i). a_i and alpha_i
follow from the common normal of the axes i and i+1; the frames of the first and the last joint
are free and put all of their place into the base B and the tool T. Modified tables (Craig 1986)
hold the same numbers, a and alpha one row lower.

Axes that are nearly parallel have their common normal far away: d_i and d_i+1 then grow, exactly
opposite, and nothing is wrong. Sources: Denavit and Hartenberg (1955); Craig (1986).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.rest import RestChain, RestJoint

Array = NDArray[np.float64]
PARALLEL = 3e-10
"""Sine [rad] between axes that count as parallel: nearer ones meet 3,000 km away per mm."""


@dataclass(frozen=True)
class DenavitRow:
    """A joint: a, d [m], alpha and theta [rad] behind it, at the reading 0.

    factor: of the reading, which moves theta, or d of a slide.
    """

    joint: str
    reads: str
    kind: str
    a: float
    alpha: float
    d: float
    theta: float
    factor: float


@dataclass(frozen=True, eq=False)
class DenavitTable:
    """rows from the base to the tip; base, tool: (4, 4) ahead of the first and behind the last."""

    rows: tuple[DenavitRow, ...]
    base: Array
    tool: Array


def dh_table(chain: RestChain) -> DenavitTable:
    """The classical table of a chain; its last row has a = alpha = 0."""
    chain = chain.along_z
    base = chain.joints[0].before
    ahead = np.eye(4)  # from the table's frame of a joint to the chain's, turned about z, along z
    rows = []
    for joint, following in zip(chain.joints, chain.joints[1:], strict=False):
        row, ahead = _row(joint, ahead @ following.before)
        rows.append(row)
    last = chain.joints[-1]
    rows.append(DenavitRow(last.name, last.reads, last.kind, 0.0, 0.0, 0.0, 0.0, last.factor))
    return DenavitTable(tuple(rows), base, ahead @ chain.tip)


def _row(joint: RestJoint, T: Array) -> tuple[DenavitRow, Array]:
    """The row of a joint whose next one stands at T, and what is left of T behind the row."""
    u, p = T[:3, 2], T[:3, 3]
    across = math.hypot(u[0], u[1])
    if across < PARALLEL:
        a = math.hypot(p[0], p[1])
        theta, a = _forward(math.atan2(p[1], p[0]) if a > 0.0 else 0.0, a)
        d = float(p[2])
        alpha = 0.0 if u[2] > 0.0 else math.pi
    else:
        # x along the common normal of both axes, turned forward: theta within a quarter turn
        theta, _ = _forward(math.atan2(u[0], -u[1]), 0.0)
        normal = np.array([math.cos(theta), math.sin(theta)])
        a = float(normal @ p[:2])
        # Rx(alpha) turns z by alpha, away from the direction z x normal.
        alpha = math.atan2(normal[1] * u[0] - normal[0] * u[1], u[2])
        # the next axis, p + s u, comes nearest to z where p + s u - a normal is along z
        s = -float(p[:2] @ u[:2]) / across**2
        d = float(p[2] + s * u[2])
    row_transform = _dh(theta, d, a, alpha)
    row = DenavitRow(joint.name, joint.reads, joint.kind, a, alpha, d, theta, joint.factor)
    # What the four numbers cannot express lies about and along the next z; the next row takes it.
    left: Array = np.linalg.inv(row_transform) @ T
    return row, left


def _forward(theta: float, a: float) -> tuple[float, float]:
    """The same normal with theta within a quarter turn, which is where drawings put it."""
    if abs(theta) <= 0.5 * math.pi:
        return theta, a
    return theta - math.copysign(math.pi, theta), -a


def _dh(theta: float, d: float, a: float, alpha: float) -> Array:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def modified(table: DenavitTable) -> DenavitTable:
    """The modified table of a classical one: a and alpha stand ahead of their joint."""
    ahead = [(0.0, 0.0), *((row.a, row.alpha) for row in table.rows)]
    rows = tuple(
        DenavitRow(r.joint, r.reads, r.kind, a, alpha, r.d, r.theta, r.factor)
        for r, (a, alpha) in zip(table.rows, ahead, strict=False)
    )
    a, alpha = ahead[-1]
    return DenavitTable(rows, table.base, _dh(0.0, 0.0, a, alpha) @ table.tool)
