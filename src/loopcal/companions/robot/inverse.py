"""Joints at which an arm's tool has a given pose: damped Gauss-Newton from a nearby solution.

    q <- q + s (J^+ e + (1 - J^+ J)(q_0 - q)),    e = log(f(q)^-1 T) as a twist in the base,

with s <= 1 such that no joint moves by more than 0.2 rad (or m) in one step; to |e| < 1e-10. A
redundant arm stays as near to q_0 as it can. An arm of fewer than six joints cannot reach every
pose: it reaches the position, and the turn as nearly as its joints allow.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.robot.arms import ArmPose
from loopcal.companions.robot.rigid import between

# [m, rad] 0.1 nm: far below any machine, and above what rounding leaves of metres.
SETTLED = 1e-10
# Within 0.2 rad the first order is good enough that steps shorten the way; 100 cross any workspace.
_STEPS, _LONGEST = 100, 0.2
_SINGULAR = 1e-8
"""Singular values below this share of the largest move nothing."""
_WEAK = 1e-2
"""Of an arm of few joints: directions that it moves less than this [m, rad per rad] it cannot
move: they are what a drawing has not and calibrated tilts make."""


@dataclass(frozen=True, eq=False)
class Solved:
    """joints (N, n) [rad, m]; left (N, 6): the twist that still leads to the target; settled (N,):
    whether no step would bring it nearer."""

    joints: Array
    left: Array
    settled: NDArray[np.bool_]


def solve(arm: ArmPose, target: Array, start: Array, steps: int | None = None) -> Solved:
    """Joints near `start` (N, n) that bring the tool to the poses `target` (N, 4, 4).

    A redundant arm keeps near the start. steps: at most, by default 100.
    """
    q = np.array(start, dtype=float)
    settled = np.zeros(len(q), dtype=bool)
    left = np.empty((len(q), 6))
    active = np.arange(len(q))
    for _ in range(_STEPS if steps is None else steps):
        T, J = arm.moving(q[active])
        left[active] = between(T, target[active])
        step = _step(J, left[active], start[active] - q[active])
        size = np.abs(step).max(axis=1)
        sound = np.isfinite(size)
        done = sound & (size < SETTLED) & (_reached(left[active]) | (q.shape[1] < 6))
        settled[active[done]] = True
        moving = sound & ~done
        scale = np.minimum(1.0, _LONGEST / np.maximum(size[moving], 1e-300))
        active = active[moving]
        q[active] += scale[:, None] * step[moving]
        if not active.size:
            break
    return Solved(q, left, settled)


def _reached(left: Array) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.abs(left).max(axis=1) < SETTLED
    return near


def _step(J: Array, e: Array, back: Array) -> Array:
    """(N, n) the step of each arm."""
    n = J.shape[2]
    out = np.full((len(J), n), np.nan)
    good = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(e).all(axis=1)
    J, e, back = J[good], e[good, :, None], back[good, :, None]
    if n >= 6:
        inverse = _inverse(J)
        step = inverse @ e
        if n > 6:
            step = step + back - inverse @ (J @ back)
    # The position first, the turn by what is left of the joints.
    else:
        first = _strong(J[:, :3])
        step = first @ e[:, :3]
        free = np.eye(n) - first @ J[:, :3]
        turning = J[:, 3:] @ free
        step = step + _strong(turning) @ (e[:, 3:] - J[:, 3:] @ step)
    out[good] = step[:, :, 0]
    return out


def _inverse(J: Array) -> Array:
    """The pseudo-inverses (N, n, 6): by elimination where J is square and far from singular."""
    if J.shape[1] == J.shape[2]:
        with suppress(np.linalg.LinAlgError):
            inverse = np.asarray(np.linalg.inv(J), dtype=np.float64)
            size = np.linalg.norm(J, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
            singular = ~(size < 1e-2 / _SINGULAR)
            if singular.any():
                inverse[singular] = np.linalg.pinv(J[singular], rcond=_SINGULAR)
            return inverse
    return np.asarray(np.linalg.pinv(J, rcond=_SINGULAR), dtype=np.float64)


def _strong(J: Array) -> Array:
    """The pseudo-inverse (N, n, m) over the directions that J (N, m, n) moves by enough."""
    U, s, V = np.linalg.svd(J, full_matrices=False)
    inverse = np.where(s > _WEAK, 1.0 / np.maximum(s, _WEAK), 0.0)
    pseudo_inverse: Array = np.swapaxes(V, 1, 2) * inverse[:, None, :] @ np.swapaxes(U, 1, 2)
    return pseudo_inverse


def least_gain(J: Array) -> Array:
    """(N,) smallest singular value of J (N, 6, n) [m and rad per rad or m]: 0 where it is singular.

    Of an arm of fewer than six joints, the smallest of those it has.
    """
    gains = np.zeros(len(J))
    good = np.isfinite(J).all(axis=(1, 2))
    gains[good] = np.linalg.svd(J[good], compute_uv=False)[:, -1]
    return gains
