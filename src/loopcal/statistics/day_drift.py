"""A drift along the run of another day, tested with the covariance of the calibration.

With e = F d + A h + v of `innovation`, S = 1 + A A^T, and U the columns of what changes in
proportion to the number of the pose, less what is placed anew and what changed before the run takes
up,

    t = G^-1 g,   G = U^T S^-1 U,   g = U^T S^-1 e,   gain = g^T t,

F with the rank of G if nothing drifts. What is not known of the machine is in S. `change_points`
learns smooth functions of the joints from these few poses instead, which take up most of a drift.
Where the equations scatter more than stated beside the drift, S is multiplied by that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from loopcal.arrays import Array
from loopcal.document.change_points import NOT_SEARCHED, Change, ChangePoint, Moved, Shifts
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.lazy import cached_property
from loopcal.small_samples import f_limit, f_tail, t_quantile
from loopcal.statistics.another_day import Day
from loopcal.statistics.change_points import ALIKE, DRIFTING, LEAST, RARE
from loopcal.statistics.change_tests import Explained, what_changed
from loopcal.statistics.changed import POWER, Candidate
from loopcal.statistics.estimated import Estimated
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.possible_changes import (
    ALONG_A_DAY,
    Possible,
    changed_share,
    possible,
    unit_of,
)
from loopcal.statistics.run_drift import drifting
from loopcal.statistics.run_order import tells_order, told_by_joints

# Chosen, not derived: far above rounding, far below a direction that poses show.
_SHOWN = 1e-6
"""Share of the square of a column that all else must leave."""


@dataclass(frozen=True, eq=False)
class _Ramp:
    """Something that changes all along the run; scale: of S; freedom: of its variance."""

    cause: Possible
    estimated: Estimated
    scale: float
    freedom: float

    @classmethod
    def of(cls, cause: Possible, beside: _Beside, scale: float = 1.0) -> _Ramp:
        """Beside changes before the run."""
        linear = beside.linear
        raw = beside.share * beside.columns(cause)
        estimated = beside.estimated(raw)
        left = linear.innovation().degrees_of_freedom - beside.changed.shape[1] - estimated.rank
        inverse = 1.0 / float(linear.freedom(raw).min())
        # Relative variances 2 / nu of independent errors of a scale add up.
        inverse += 1.0 / max(left, 1) if scale > 1.0 else 0.0
        freedom = 1.0 / inverse if inverse else math.inf
        return cls(cause, estimated, scale, freedom)

    @property
    def log_p(self) -> float:
        """Log of the probability of such a gain where nothing drifts."""
        gain, rank = self.estimated.gain / self.scale, self.estimated.rank
        return math.log(max(f_tail(gain, rank, self.freedom), 1e-300)) if rank else 0.0

    def smallest(self, level: float) -> float | None:
        """The smallest drift [unit] that is seen with the stated power, in the direction that these
        poses show worst; None where they do not show all."""
        rank, count = self.estimated.rank, len(self.estimated.size)
        if rank < count:
            return None
        critical = math.sqrt(float(f_limit(1.0 - level, rank, np.array([self.freedom]))[0]))
        worst = float(np.linalg.eigvalsh(self.estimated.covariance)[-1])
        reach = critical + t_quantile(2.0 * POWER - 1.0, self.freedom)
        return reach * math.sqrt(self.scale * worst)


@dataclass(frozen=True, eq=False)
class _Beside:
    """The equations of a day, beside changes before its run of columns (R, d)."""

    day: Day
    linear: Linearised
    changed: Array

    @cached_property
    def share(self) -> Array:
        """(R, 1) from 0 at the first pose to 1 at the last."""
        return self.day.share_of_run(self.linear.placement) + 0.5

    def columns(self, cause: Possible) -> Array:
        """(R, d) of something that changes by 1."""
        made = cause.columns(self.linear.placement.columns) / np.sqrt(self.linear.factor)
        return np.asarray(made)

    def estimated(self, raw: Array) -> Estimated:
        """The change of these columns."""
        d, linear = self.changed.shape[1], self.linear
        X = np.hstack([self.changed, raw])
        U = X - linear.F @ (linear.solve @ X)
        G, g = linear.weighed(U, U), linear.weighed(U, linear.left)
        by = np.linalg.lstsq(G[:d, :d], G[:d, d:], rcond=None)[0]
        G, g = G[d:, d:] - G[d:, :d] @ by, g[d:] - by.T @ g[:d]
        length = np.linalg.norm(raw, axis=0)
        to_one = 1.0 / np.where(length > 0.0, length, 1.0)
        return Estimated.of(to_one * g, G * np.outer(to_one, to_one), to_one, _SHOWN)

    def steps(self) -> Iterator[float]:
        """Log p of each step of a cause between two poses."""
        end = len(self.day.problem.poses) - LEAST
        number = np.round((len(self.day.problem.poses) - 1) * self.share)
        for cause in (one for one in possible(self.day.problem, ALONG_A_DAY) if one.steps):
            raw, rare = self.columns(cause), RARE.get(cause.kind, 0.0)
            for at in range(LEAST, end + 1):
                yield self.estimated(changed_share(number, at, None) * raw).log_p() + rare


def smallest_drift(day: Day, linear: Linearised, scale: float) -> Candidate | None:
    """The drift of the instrument that these poses show; None where it has angles alone, or poses
    do not show it.

    scale: by how much these poses vary more than stated.
    """
    names, tests = drifting(day.problem.mechanism), len(_causes(day))
    if not tests or {unit_of(day.problem, n) for n in names} != {"m"}:
        return None
    beside = _Beside(day, linear, np.zeros((len(linear.e), 0)))
    smallest = _Ramp.of(Possible("reading", names), beside, scale).smallest(
        NOT_SEARCHED.level / tests
    )
    if smallest is None:
        return None
    return Candidate("the instrument", "drift", "m", None, smallest)


def drifted(day: Day, explained: Explained) -> tuple[Shifts, Day, Explained] | None:
    """The drift of this run, the day with it and what changed beside it; None without any.

    Of several causes the most significant, with those that explain it about as well. None where a
    step explains the poses far better.
    """
    level, equations = NOT_SEARCHED.level, _Beside(day, explained.linear, explained.columns)
    ramps = [_Ramp.of(one, equations) for one in _causes(day)]
    if not ramps:
        return None
    best = min(ramps, key=lambda one: one.log_p + ALIKE * (one.cause.kind not in DRIFTING))
    limit = math.log(level / len(ramps))
    if best.log_p >= limit:
        return None
    if min(equations.steps(), default=0.0) < best.estimated.log_p() - ALIKE:
        return None
    moved = replace(day, moved=(*day.moved, _point(day, best, ramps)))
    beside = what_changed(moved, moved.linearised())
    if beside is None:
        return None
    best = _Ramp.of(best.cause, equations, _scale(beside))
    if best.log_p >= limit:
        return None
    joints = day.problem.readings[joint_rows(day.problem)][:, pose_order(day.problem)].T
    # What is not known of the machine is in S, so that few poses in random order will do.
    sure = best.cause.kind in DRIFTING and not tells_order(joints)
    point = replace(_point(day, best, ramps), imitated=told_by_joints(joints) is not None)
    shifts = Shifts((point,), level, len(day.problem.poses), told_apart=(point,) if sure else ())
    return shifts, moved, beside


def _causes(day: Day) -> list[Possible]:
    """What may change all along a run."""
    return [one for one in possible(day.problem, ALONG_A_DAY) if one.ramps]


def _scale(explained: Explained) -> float:
    """By how much the equations scatter more than stated."""
    left = explained.linear.innovation()
    count = left.degrees_of_freedom - explained.columns.shape[1]
    return max(explained.what.spread, left.value / count if count > 0 else 1.0, 1.0)


def _point(day: Day, best: _Ramp, ramps: list[_Ramp]) -> ChangePoint:
    """As it is reported."""
    cause, poses, order = best.cause, day.problem.poses, pose_order(day.problem)
    sds = best.estimated.sds * math.sqrt(best.scale)
    units = cause.part_units(day.problem)
    # Of an instrument by how much its reading exceeds the true value, as `change_points` has it.
    sign = -1.0 if cause.kind == "reading" else 1.0
    size = (sign * best.estimated.size).tolist()
    sizes = zip(cause.titles, size, sds.tolist(), units, strict=True)
    alike = [
        one.cause
        for one in ramps
        if not {*one.cause.names} & {*cause.names} and one.log_p < best.log_p + ALIKE
    ]
    return ChangePoint(
        "ramp",
        poses[order[0]],
        poses[order[-1]],
        1,
        cast(Moved, cause.kind),
        {name: Change(size, sd, unit) for name, size, sd, unit in sizes},
        best.estimated.gain / best.scale,
        min(1.0, math.exp(best.log_p) * len(ramps)),
        tuple(one.label or ", ".join(one.titles) for one in alike),
        until=len(order),
        of=cause.label if cause.kind in ("station", "target") else "",
    )
