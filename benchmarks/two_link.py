"""The planar two-link arm by hand, all poses at once: the seed's equations (4.1) and (4.2).

joints (2, N): phi2, phi3; p (6,): xA, yA, l2, l3, phi20, phi30.
"""

from __future__ import annotations

import numpy as np
from chain import Chain, Factor
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _directions(joints: Array, p: Array) -> tuple[Array, Array]:
    """Unit vectors along both links, (2, N) each."""
    a = joints[0] + p[4]
    b = a + joints[1] + p[5]
    return np.stack([np.cos(a), np.sin(a)]), np.stack([np.cos(b), np.sin(b)])


def _left(v: Array) -> Array:
    """Vectors (2, N) turned by a right angle."""
    return np.stack([-v[1], v[0]])


def point(joints: Array, p: Array) -> Array:
    """The point reached, (2, N)."""
    u, v = _directions(joints, p)
    return np.asarray(p[:2, None] + p[2] * u + p[3] * v)


def by_joint(joints: Array, p: Array) -> Array:
    """Derivatives by the joints, (2, 2, N): a joint turns all that lies behind it."""
    u, v = _directions(joints, p)
    outer = p[3] * _left(v)
    return np.stack([p[2] * _left(u) + outer, outer], axis=1)


def by_parameter(joints: Array, p: Array) -> Array:
    """Derivatives by the parameters, (2, 6, N)."""
    u, v = _directions(joints, p)
    turned = by_joint(joints, p)
    moved = np.broadcast_to(np.eye(2)[:, :, None], (2, 2, joints.shape[1]))
    return np.concatenate([moved, u[:, None], v[:, None], turned], axis=1)


def chain() -> Chain:
    """The same arm as a product: Tx(xA) Ty(yA) Rz(phi20) Rz(phi2) Tx(l2) Rz(phi30) Rz(phi3)."""
    x, y, z = range(3)
    foot = (Factor("t", x, 0), Factor("t", y, 1))
    shoulder = (Factor("r", z, 4), Factor("r", z, None, 0))
    elbow = (Factor("t", x, 2), Factor("r", z, 5), Factor("r", z, None, 1))
    return Chain(foot + shoulder + elbow, tip=(3,))
