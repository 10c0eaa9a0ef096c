"""The way from each pose to its neighbours in the order of the run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.parallel.free_body import COLUMNS, TURNS
from loopcal.statistics.run_order import told_by_joints

WAYS = {"a delay towards the next pose": 1, "a delay since the last pose": -1}
"""By the name of a delay t where its way m leads: x = r + t m(x), r what was read."""
# Chosen, not derived: each round leaves twice the delay of what the one before has moved.
_ROUNDS = 12


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


def told(problem: Problem) -> bool:
    """Whether the joints tell the order: then what a delay does, the machine may do."""
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
