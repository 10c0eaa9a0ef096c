"""All joints that give a pose by a controller's model, where the program does not state them.

Gauss-Newton from many starts within the joints' limits; solutions that differ by whole turns are
one. Turns are added where the limits allow, for programs that state the turn.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms
from loopcal.deployment.inverse import solve
from loopcal.deployment.rigid import between

Array = NDArray[np.float64]
_STARTS = 96
_ALIKE = 1e-5
_TURN = 2.0 * math.pi
_NEAR = 1e-8


def solutions(arms: Arms, pose: Array) -> Array:
    """(m, n) joints [rad, m] within +-half a turn that give the pose (4, 4) by the controller."""
    turning = np.array([unit == "rad" for unit in arms.joints.values()])
    spans = arms.spans()
    low = np.where(turning, np.maximum(spans[:, 0], -math.pi), np.maximum(spans[:, 0], -1.0))
    high = np.where(turning, np.minimum(spans[:, 1], math.pi), np.minimum(spans[:, 1], 1.0))
    starts = np.random.default_rng(0).uniform(low, high, (_STARTS, len(turning)))
    poses = np.broadcast_to(pose, (_STARTS, 4, 4))
    found = solve(arms.controller, poses, starts)
    left = np.abs(between(arms.controller(found.joints), poses)).max(axis=1)
    kept: list[Array] = []
    for q in found.joints[found.settled & (left < _NEAR)]:
        q = np.where(turning, np.remainder(q + math.pi, _TURN) - math.pi, q)
        if not any(_apart(q, other, turning) < _ALIKE for other in kept):
            kept.append(q)
    return np.array(kept).reshape(-1, len(turning))


def _apart(q: Array, other: Array, turning: NDArray[np.bool_]) -> float:
    d = q - other
    return float(np.abs(np.where(turning, np.remainder(d + math.pi, _TURN) - math.pi, d)).max())


def with_turns(arms: Arms, q: Array, most: int) -> list[Array]:
    """A solution (n,) with whole turns added to its joints, wherever the limits allow them.

    most: turns of a joint whose limits are not stated, beyond half a turn to both sides. What
    differs by whole turns alone has the same pose and the same correction.
    """
    spans = arms.spans()
    reach = (most + 0.5) * _TURN + _NEAR
    spans = np.where(np.isfinite(spans), spans, [-reach, reach])
    ways = [
        [v + k * _TURN for k in (-1, 0, 1) if low <= v + k * _TURN <= high]
        if unit == "rad"
        else [v]
        for v, unit, (low, high) in zip(q, arms.joints.values(), spans, strict=True)
    ]
    return [np.array(way) for way in product(*ways)]
