"""Whether what changes along a run can be told from what changes with the joints.

In random order it can. Where the joints follow the order, as along a path or in layers of a grid,
an error of the machine model does what a change along the run does. In random order it also shows
whether poses were read early or late: on the way to the next pose, or from the last one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.parallel.free_body import COLUMNS, TURNS

# Half: docs/decisions/0051.
FOLLOWED = 0.5
"""Adjusted R^2 above which the joints tell the order."""
SPARE = 16
"""Poses beyond the columns of a regression, and as many as these: with fewer the joints of 2 % and
more of random orders seem to tell it."""
# Chosen, not derived: more cosines describe more, and take up real steps.
DESCRIBED = 0.99
"""The share of the variance of every joint that its description leaves nothing of to see."""
# Chosen, not derived: with more cosines any order of poses looks like a path.
MOST = 3
"""So many poses for each cosine at least: as many cosines as poses describe any order."""
WAYS = {"a delay towards the next pose": 1, "a delay since the last pose": -1}
"""By the name of a delay t where its way m leads: x = r + t m(x), r what was read."""
# Chosen, not derived: each round leaves twice the delay of what the one before has moved.
_ROUNDS = 12


def order_by_joints(joints: Array, products: bool = True) -> float:
    """How far the joints (N, n), in order, tell the number of the pose.

    The adjusted R^2 of its regression on them and on their products of second order: about 0 in
    random order, 1 along a path. 1 where there are too few poses for the regression.
    """
    N = len(joints)
    scaled = _scaled(joints)
    first, second = np.triu_indices(scaled.shape[1])
    columns = np.column_stack([np.ones(N), scaled, scaled[:, first] * scaled[:, second]])
    columns = columns if products else columns[:, : 1 + scaled.shape[1]]
    time = np.arange(N) - 0.5 * (N - 1)
    spare = N - columns.shape[1]
    if spare < 1:
        return 1.0
    left = time - columns @ np.linalg.lstsq(columns, time, rcond=None)[0]
    explained: float = 1.0 - float(left @ left) / spare * (N - 1) / float(time @ time)
    return explained


def told_by_joints(joints: Array) -> float | None:
    """`order_by_joints` where the joints (N, n), in order, tell the number of the pose; else None.

    By the joints alone where poses are too few for products; None where they are too few for both.
    """
    N, n = joints.shape
    if not n or not np.isfinite(joints).all():
        return None
    # Constant, joints, and their products of second order.
    for products, columns in ((True, (n + 1) * (n + 2) // 2), (False, n + 1)):
        if columns + max(columns, SPARE) <= N:
            share = order_by_joints(joints, products)
            return share if share > FOLLOWED else None
    return None


def tells_order(joints: Array) -> bool:
    """Whether joints (N, n) tell the order of the poses: by their products where poses are enough,
    and by themselves, of few poses too."""
    told = told_by_joints(joints) is not None
    return told or order_by_joints(joints, products=False) >= FOLLOWED


def path_cosines(joints: Array) -> int:
    """How many slow cosines over the run describe the squares of the joints (N, n), in order: the
    errors of a machine along this path are as fast. 0 where the joints follow no path."""
    N, scaled = len(joints), _scaled(joints)
    phase = np.pi * (np.arange(N) + 0.5) / N
    # Orthonormal (DCT-II): squared products with the joints are then shares of their variance.
    cosines = np.cos(np.outer(phase, np.arange(1, N // (2 * MOST) + 1))) * np.sqrt(2.0 / N)
    shares = np.cumsum(np.square(cosines.T @ scaled), axis=0) / np.square(scaled).sum(axis=0)
    if not shares.size:
        return 0
    # cos^2 a = (1 + cos 2 a) / 2: squares of the joints are twice as fast as the joints.
    enough = np.flatnonzero(shares.min(axis=1) >= DESCRIBED)
    return 2 * (int(enough[0]) + 1) if enough.size else 0


def _scaled(joints: Array) -> Array:
    """Joints that move, by their mean and spread."""
    spread = np.std(joints, axis=0)
    moving = spread > 1e-9
    scaled: Array = (joints[:, moving] - joints[:, moving].mean(axis=0)) / spread[moving]
    return scaled


def ways(problem: Problem, step: int) -> Array:
    """(N, q) of what is read of each pose, to the next (1) or the last (-1); none at the ends."""
    order = pose_order(problem)
    to, every = order.copy(), np.arange(len(order))
    to[order] = order[np.clip(every + step, 0, len(order) - 1)]
    return motions(problem, joint_rows(problem), to, every)


def delayed(problem: Problem, name: str, share: float) -> Problem:
    """With where the machine was in place of what was read, after this delay."""
    rows, at = joint_rows(problem), problem
    for _ in range(_ROUNDS):
        readings = problem.readings.copy()
        readings[rows] += share * ways(at, WAYS[name]).T
        at = replace(problem, readings=readings)
    return at


def like_a_delay(problem: Problem) -> bool:
    """Whether the machine may do what a delay does, because the poses tell their order."""
    order = pose_order(problem)
    return told_by_joints(motions(problem, joint_rows(problem), order)) is not None


def motions(
    problem: Problem, rows: Sequence[int], to: NDArray[np.intp], of: NDArray[np.intp] | None = None
) -> Array:
    """(N, q) of the readings in these rows, to these poses from others, or from their mean; small
    turns of a body that is turned freely as the vector of its rotation."""
    read = problem.readings[list(rows)].T
    by = read[to] - (read.mean(axis=0) if of is None else read[of])
    names = [problem.mechanism.tape.quantities[i] for i in rows]
    constants = list(problem.mechanism.pose_constants)
    if {*TURNS} <= {*names} and {*COLUMNS} <= {*constants}:
        from scipy.spatial.transform import Rotation

        w, *xyz = (problem.pose_constants[constants.index(c)] for c in COLUMNS)
        at = [names.index(t) for t in TURNS]
        R = Rotation.from_quat(np.column_stack([*xyz, w])) * Rotation.from_rotvec(read[:, at])
        turns = ((R.mean() if of is None else R[of]).inv() * R[to]).as_rotvec()
        by[:, at] = turns
    return np.asarray(by)
