"""What a calibration has to beat: the nominal machine, and plain least squares, in code of its own.

Both have the reflector and each station fitted to the file of the first day, as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from analyses.gauntlet_truth import Arm, Array
from analyses.lives_parallel import RotaryDelta
from analyses.lives_truth import TOOL, Machine, off, placement, roles

SIZES = {"zero": 5e-3, "twist": 1e-3, "length": 5e-4}
"""By what parameters are scaled for the fit [rad, rad, m]."""


@dataclass(frozen=True)
class Rival:
    """A machine with its reflector, and where its first station stands."""

    arm: Arm | RotaryDelta
    target: Array
    turn: Array
    shift: Array

    def points(self, q: Array) -> Array:
        """Of the reflector in the frame of the first station (N, 3)."""
        out: Array = reached(self.arm, self.target, q) @ self.turn.T + self.shift
        return out


def reached(arm: Arm | RotaryDelta, target: Array, q: Array) -> Array:
    """Points of a reflector in the base."""
    R, o = arm.flange(q)
    p: Array = o + R @ target
    return p


def rival(user: Machine, q: Array, p: Array, stations: NDArray[np.intp], *, fitted: bool) -> Rival:
    """The drawing, or the machine that squares fit: joints (N, n), points (N, 3), station (N,)."""
    scales = np.array([SIZES[role] for role in roles(user.drawing)] if fitted else [])
    groups = [stations == s for s in np.unique(stations)]

    def at(x: Array) -> tuple[Arm | RotaryDelta, Array]:
        target = TOOL + 2e-3 * x[:3] * user.turns
        return (off(user.drawing, scales * x[3:]) if fitted else user.drawing), target

    def apart(x: Array) -> Array:
        points = reached(*at(x), q)
        for rows in groups:
            R, shift = placement(points[rows], p[rows])
            points[rows] = points[rows] @ R.T + shift
        return np.concatenate([1e5 * (points - p).ravel(), 1e-3 * x])  # what nothing moves stays

    start = np.zeros(3 + len(scales))
    best = least_squares(apart, start, max_nfev=15)
    arm, target = at(best.x)
    first = groups[int(stations[0] != np.unique(stations)[0])]
    turn, shift = placement(reached(arm, target, q[first]), p[first])
    return Rival(arm, target, turn, shift)
