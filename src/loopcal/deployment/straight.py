"""Straight moves between corrected targets: how far the machine is off the line in between.

The controller moves the tool on a straight line between two poses by its own model, so the machine
reaches the wanted line at its ends alone. In between, at a share s of the way,

    error(s) = f(q(s)) less line(s),    f_c(q(s)) on the controller's line.

Wanted poses in between, corrected and inserted, shorten the lines: the error falls with the square
of their length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms
from loopcal.deployment.inverse import solve
from loopcal.deployment.rigid import between, moved

Array = NDArray[np.float64]
_SHARES = np.linspace(0.0, 1.0, 9)[1:]
MOST = 63
"""Targets that are inserted into one move, at most."""
_MANY = f"more than {MOST} targets would be needed"


@dataclass(frozen=True, eq=False)
class StraightMove:
    """A straight move from one target to another (their indices), in a line of the program.

    error: the largest distance [m] of the tool's point from the wanted one in between, inf where
    the controller does not follow the line; inserted: (k, n) joints of targets in between; why:
    none were inserted although the error is above the bound, empty elsewhere.
    """

    begin: int
    end: int
    line: int
    error: float
    inserted: Array
    why: str = ""


def straight_move(
    arms: Arms, ends: tuple[int, int], line: int, joints: Array, wanted: Array, bound: float | None
) -> StraightMove:
    """A move between two targets, whose corrected joints are (2, n), wanted poses (2, 4, 4).

    bound: targets are inserted, at equal shares, until the error is below it [m]. Where 63 do not
    suffice, none are inserted.
    """
    none = np.empty((0, joints.shape[1]))
    error = _error(arms, joints, wanted)
    if bound is None or error <= bound:
        return StraightMove(*ends, line, error, none)
    if not math.isfinite(error):
        return StraightMove(*ends, line, error, none, "the controller does not follow the line")
    if math.sqrt(error / max(bound, 1e-300)) > 2 * MOST:
        return StraightMove(*ends, line, error, none, _MANY)  # far more would be needed
    pieces = 2
    while pieces - 1 <= MOST:
        q, T = _divided(arms, joints, wanted, pieces)
        if not np.isfinite(q).all():
            break
        parts = [_error(arms, q[i : i + 2], T[i : i + 2]) for i in range(pieces)]
        if max(parts) <= bound:
            return StraightMove(*ends, line, max(parts), q[1:-1])
        pieces *= 2
    return StraightMove(*ends, line, error, none, _MANY)


def _divided(arms: Arms, joints: Array, wanted: Array, pieces: int) -> tuple[Array, Array]:
    """Corrected joints (pieces + 1, n), NaN where there are none, and wanted poses of them."""
    way = between(wanted[:1], wanted[1:])
    shares = np.linspace(0.0, 1.0, pieces + 1)
    T = np.concatenate([moved(wanted[:1], way, float(s)) for s in shares])
    q = [joints[0]]
    for pose in T[1:-1]:
        found = solve(arms.machine, pose[None], q[-1][None])
        q.append(found.joints[0] if found.settled[0] else np.full(joints.shape[1], np.nan))
    return np.array([*q, joints[1]]), T


def _error(arms: Arms, joints: Array, wanted: Array) -> float:
    """The largest distance [m] between the ends."""
    ends = arms.controller(joints)
    line, path = between(wanted[:1], wanted[1:]), between(ends[:1], ends[1:])
    q, errors = joints[:1], [0.0]
    for share in _SHARES.tolist():
        found = solve(arms.controller, moved(ends[:1], path, share), q)
        if not found.settled[0]:
            return math.inf
        q = found.joints
        off = between(moved(wanted[:1], line, share), arms.machine(q))
        errors.append(float(np.linalg.norm(off[0, :3])))
    if np.abs(q - joints[1:]).max() > 1e-3:
        return math.inf  # the line ends in another configuration
    return max(errors)
