"""Straight moves between corrected targets: how far the machine is off the line in between.

The controller moves the tool on a straight line between two poses by its own model. So the machine
meets the wanted line at its ends alone. In between, at a share s of the way,

    error(s) = f(q(s)) less line(s),    f_c(q(s)) on the controller's line.

Wanted poses in between, corrected and inserted, shorten the lines: the error falls with the square
of their length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms
from loopcal.deployment.inverse import solve
from loopcal.deployment.rigid import between, moved

Array = NDArray[np.float64]
_AT = np.linspace(0.0, 1.0, 9)[1:]
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


def divided(
    arms: Arms, move: StraightMove, joints: Array, wanted: Array, bound: float
) -> StraightMove:
    """A move between two targets, whose corrected joints are (2, n), wanted poses (2, 4, 4).

    bound: targets are inserted, at equal shares, until the error is below it [m]. Where 63 do not
    suffice, none are inserted.
    """
    if move.error <= bound:
        return move
    if not math.isfinite(move.error):
        return replace(move, why="the controller does not follow the line")
    if math.sqrt(move.error / max(bound, 1e-300)) > 2 * MOST:
        return replace(move, why=_MANY)  # far more would be needed
    pieces = 2
    while pieces - 1 <= MOST:
        q, T = _shares(arms, joints, wanted, pieces)
        if not np.isfinite(q).all():
            break
        parts = line_errors(arms, *(np.stack([v[:-1], v[1:]], axis=1) for v in (q, T)))
        if parts.max() <= bound:
            return replace(move, error=float(parts.max()), inserted=q[1:-1])
        pieces *= 2
    return replace(move, why=_MANY)


def _shares(arms: Arms, joints: Array, wanted: Array, pieces: int) -> tuple[Array, Array]:
    """Corrected joints (pieces + 1, n), NaN where there are none, and wanted poses of them."""
    way = between(wanted[:1], wanted[1:])
    shares = np.linspace(0.0, 1.0, pieces + 1)
    T = np.concatenate([moved(wanted[:1], way, float(s)) for s in shares])
    q = [joints[0]]
    for pose in T[1:-1]:
        solved = solve(arms.machine, pose[None], q[-1][None])
        q.append(solved.joints[0] if solved.settled[0] else np.full(joints.shape[1], np.nan))
    return np.array([*q, joints[1]]), T


def line_errors(arms: Arms, joints: Array, wanted: Array) -> Array:
    """(M,) the largest distance [m] between the ends of each of M moves.

    joints: (M, 2, n) corrected, at the ends; wanted: (M, 2, 4, 4) their poses.
    """
    M, _, n = joints.shape
    ends = arms.controller(joints.reshape(-1, n)).reshape(-1, 2, 4, 4)
    line, path = (between(T[:, 0], T[:, 1]) for T in (wanted, ends))
    q, errors, on = joints[:, 0].copy(), np.zeros(M), np.arange(M)
    for share in _AT.tolist():
        solved = solve(arms.controller, moved(ends[on, 0], path[on], share), q[on])
        q[on] = solved.joints
        errors[on[~solved.settled]] = math.inf
        on = on[solved.settled]
        off = between(moved(wanted[on, 0], line[on], share), arms.machine(q[on]))
        errors[on] = np.maximum(errors[on], np.linalg.norm(off[:, :3], axis=1))
    elsewhere = np.abs(q - joints[:, 1]).max(axis=1) > 1e-3
    errors[elsewhere] = math.inf  # the line ends in another configuration
    return errors
