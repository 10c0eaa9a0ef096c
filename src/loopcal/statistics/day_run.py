"""What happened during a run of another day, searched as in the run of a calibration.

At the held machine the equations of the poses are

    e = F d + A h + v,   h ~ N(0, 1),   v ~ N(0, 1),

as `innovation` has them. In the order of the poses they are searched for what moved between two of
them or all along the run (`change_points`), and for poses that fit neither the machine nor each
other. Where the machine misses the readings by far, the file may be at fault (`faults`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.document.change_points import NOT_SEARCHED, ChangePoint, Shifts
from loopcal.document.findings import ColumnFault
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.problem.problem import Problem
from loopcal.statistics.another_day import Day
from loopcal.statistics.change_points import DRIFTING, LEAST, MOST_POSES, Search
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.ordered_system import Fitted, OrderedSystem
from loopcal.statistics.possible_changes import ALONG_A_DAY
from loopcal.statistics.replacing import ASTRAY
from loopcal.statistics.run_order import tells_order

# Chosen, not derived: one good run of a hundred, as of the poses of a calibration.
_LEVEL = 0.01
"""Probability of calling any of the poses unlike the others where all are good."""
# Chosen, not derived: where more are unlike the others, it is the machine or the sds.
_MOST = 0.1
# Chosen, not derived: nine equations of a held machine show a target that moved.
_LEAST = 3
"""Poses between two changes of a short run; of a longer one a quarter of it, up to `LEAST`."""
NO_POSES: NDArray[np.intp] = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True)
class Run:
    """shifts: what moved along the run; outliers: positions of the poses that do not fit the
    others."""

    shifts: Shifts = NOT_SEARCHED
    outliers: tuple[int, ...] = ()

    def among(self, problem: Problem, outliers: NDArray[np.intp]) -> Run:
        """The same where all poses of a day are counted, those that were left out too."""
        numbers = np.flatnonzero(~np.isin(pose_order(problem), outliers)) + 1

        def counted(points: tuple[ChangePoint, ...]) -> tuple[ChangePoint, ...]:
            return tuple(
                replace(
                    one,
                    number=int(numbers[one.number - 1]),
                    until=None if one.until is None else int(numbers[one.until - 1]),
                )
                for one in points
            )

        shifts = replace(
            self.shifts,
            found=counted(self.shifts.found),
            unsure=counted(self.shifts.unsure),
            told_apart=counted(self.shifts.told_apart),
        )
        return Run(shifts, tuple(outliers.tolist()))


def with_further(
    problem: Problem, outliers: NDArray[np.intp], further: Sequence[int]
) -> NDArray[np.intp] | None:
    """The positions of outliers, with further ones among the poses that are left; None where they
    are too many."""
    left = np.setdiff1d(np.arange(len(problem.poses)), outliers)
    every = np.union1d(outliers, left[list(further)])
    return None if len(every) > max(1.0, _MOST * len(problem.poses)) else every


def faults(day: Day, linear: Linearised) -> tuple[ColumnFault, ...]:
    """The faults of the file of a day, sought where the held machine misses its readings by far."""
    if linear.placement.merit <= ASTRAY * len(linear.e):
        return ()
    problem, parameters = day.problem, day.problem.mechanism.parameters
    # Wherever the instruments stand: the search begins where points are best aligned.
    flat = parameters.with_prior(dict.fromkeys(parameters.of_role("placement"), math.inf))
    return column_faults(replace(problem, mechanism=problem.mechanism.with_parameters(flat)))


def searched(linear: Linearised, changed: Array) -> Run:
    """What happened during the run of a day, beside changes before it with these columns (R, d)."""
    system = _system(linear, changed)
    count = len(linear.placement.problem.poses)
    if not 2 * _LEAST < count <= MOST_POSES:
        return Run(outliers=_outliers(linear, system.fitted()))
    least = min(max(_LEAST, count // 4), LEAST)
    shifts, fit = Search(system, causes=ALONG_A_DAY, least=least).run()
    return Run(_clear(shifts, linear.placement.problem), _outliers(linear, fit))


def _clear(shifts: Shifts, problem: Problem) -> Shifts:
    """With drifts told apart from the held machine, whose errors need fewer poses for that."""
    if tells_order(problem.readings[joint_rows(problem)][:, pose_order(problem)].T):
        return shifts
    apart = tuple(
        one
        for one in shifts.found
        if one in shifts.told_apart or (one.shape == "ramp" and one.moved in DRIFTING)
    )
    return replace(shifts, told_apart=apart)


def _outliers(linear: Linearised, fit: Fitted) -> tuple[int, ...]:
    """Poses that stand out of the scatter of the others, and of what is stated.

    More than a tenth of all are none; but of so few poses that one is the most, the worst may be,
    without which the run is searched again.
    """
    squares = linear.by_pose()
    stated: Array = tail(np.nan_to_num(squares.squares), np.maximum(squares.loops, 1))
    order, count = fit.system.order, len(fit.system.order)
    # Weighed by their own scatter, of few equations: as F, by its leading term.
    spare = max(fit.spare, 1.0)
    with np.errstate(divide="ignore"):
        logs = np.log(fit.p_values)
    few = -0.5 * (spare + 1.0) * np.log1p(-2.0 * logs / spare)
    bad = np.asarray((few < np.log(_LEVEL / count)) & (stated[order] < _LEVEL / count))
    most = max(1.0, _MOST * count)
    if bad.sum() > most > 1.0:
        return ()
    if bad.sum() > most:
        # The worst pose pulls what is placed anew, so that good ones look bad beside it.
        bad &= few == few[bad].min()
    return tuple(sorted(order[bad].tolist()))


def _system(linear: Linearised, changed: Array) -> OrderedSystem:
    """The equations in the order of the poses; changed: (R, d) columns of what is free as well.

    What is placed anew is free, and errors of the machine have the variance 1.
    """
    placement, scale = linear.placement, 1.0 / np.sqrt(linear.factor)
    problem = placement.problem
    N, k = len(problem.poses), len(problem.readings)
    R = max(rows.e.shape[1] for rows in placement.rows)
    quantities = problem.mechanism.tape.quantities
    zeros = np.flatnonzero(np.isfinite(problem.uncertainty.sd).any(axis=1)).tolist()
    X_rows = np.zeros((len(linear.e), k))
    X_rows[:, zeros] = scale * placement.columns([quantities[i] for i in zeros])
    Z_rows, D_rows = np.hstack([linear.F, changed, linear.A]), scale * placement.J[:, problem.free]
    E, Z = np.zeros((N, R)), np.zeros((N, R, Z_rows.shape[1]))
    D, X = np.zeros((N, R, D_rows.shape[1])), np.zeros((N, R, k))
    rows, patterns, begin = np.zeros((N, R), dtype=bool), np.zeros(N, dtype=np.intp), 0
    for block in placement.rows:
        b, r = block.e.shape
        span, poses = slice(begin, begin + b * r), block.poses
        E[poses, :r] = linear.e[span].reshape(b, r)
        Z[poses, :r], D[poses, :r] = (M[span].reshape(b, r, M.shape[1]) for M in (Z_rows, D_rows))
        X[poses, :r], rows[poses, :r] = X_rows[span].reshape(b, r, k), True
        patterns[poses] = r
        begin += b * r
    # Errors of the machine have the variance 1; all else is free.
    free, held = linear.F.shape[1] + changed.shape[1], linear.A.shape[1]
    precision = np.concatenate([np.zeros(free), np.ones(held)])
    none = np.zeros(free + held)
    as_read = np.arange(N)
    count = rows.sum(axis=1)
    made = OrderedSystem(
        problem, as_read, E, Z, D, X, precision, none, patterns, rows, count, 0, 0.0
    )
    return made.in_order()
