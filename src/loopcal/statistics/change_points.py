"""Change points: where in the order of the poses something moved, and what.

A reflector slips, a tracker is knocked, a wire is zeroed anew: from a pose t on some constants have
other values. For each candidate, with columns C_i (r, d) in the whitened equations of pose i,

    gain(t) = u^T (Q - U H^-1 U^T)^-1 u,    u = sum_i>=t C_i^T e_i,  Q = sum_i>=t C_i^T C_i,
                                            U = sum_i>=t C_i^T Z_i,  H = Z^T Z + P

is what chi-squared falls by if the candidate changes at t and all else, Z, is fitted anew (Andrews
1993): what the parameters can absorb counts for nothing. Its share of the squares that are left is
tested (`log_share`), which holds for few poses too. The most significant one joins Z, all are
placed anew, and the search goes on while the next is significant after Bonferroni's correction for
all poses and candidates. A candidate may also change all along the poses in which it was seen, in
proportion to their number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from loopcal.arrays import Array
from loopcal.document.change_points import NOT_SEARCHED, Change, ChangePoint, Moved, Shifts
from loopcal.errors import InputError
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.lazy import cached_property
from loopcal.statistics.estimated import log_share
from loopcal.statistics.ordered_system import Fitted, OrderedSystem, ordered_system
from loopcal.statistics.pose_delay import pose_delay
from loopcal.statistics.possible_changes import (
    ALONG_A_RUN,
    Cause,
    Possible,
    changed_share,
    impossible,
    possible,
    sd_of,
    unit_of,
)
from loopcal.statistics.run_order import FOLLOWED, order_by_joints, path_cosines, told_by_joints
from loopcal.statistics.scales import joint_scale, range_zeros, scale_columns, scales
from loopcal.statistics.unexplained import joint_error

# Chosen, not derived: time and memory of the search.
MOST_POSES = 5000
"""More poses are not searched: parts of a long run can be."""
# Chosen, not derived: fewer poses are outliers, which have tests of their own.
LEAST = 5
"""Poses between two changes, and before the first and after the last."""
# Chosen, not derived: each costs a search, and a run with more is no run.
MOST = 8
"""Change points that are sought."""
BENDS = 4
"""Terms of a curve that a drift has where a line is not enough: with them a warm-up of 1.2 mm over
five time constants keeps 0.004 mm."""
# Record 0054: p-value of a single test.
UNREMARKABLE = 1e-3
"""A pose that is at least so probable fits."""
# Six cosines, R^2 of 0.5 and e^10 below: record 0051.
_WAVES, _EDGE = 6, 1e-3
"""A step is kept if its edge stands out of so many slow cosines over the run at this level."""
DRIFTING = ("station", "reading", "expansion")
"""What may drift: an instrument, or the scale of the whole machine. A drift is named only where the
joints do not show the order of the poses: elsewhere it looks like an error of the machine."""
RARE = {"joint": 10.0, "link": 10.0, "lens": 10.0}
"""By so much must the log p-value of a joint's zero, a link or a focal length be lower: a target
that moves about the axis of the last joint does the same as a zero, a camera that moves along its
axis much the same as a lens, and both do it more often."""
GRADUAL = ("joint", "link")
"""What may also change little by little, without a drift of it being sought."""
# A factor of e^7, about 1000, in p: chosen, not derived.
ALIKE = 7.0
"""An alternative whose log p is within this of the best explains the change about as well."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Something that may change, and its columns (N, R, d)."""

    change: Possible
    columns: Array

    @cached_property
    def seen(self) -> tuple[int, int]:
        """The first and the last position at which it does anything."""
        at = np.flatnonzero(self.columns.any(axis=(1, 2)))
        return (int(at[0]), int(at[-1])) if at.size else (0, 0)


def _together(parts: Sequence[_Candidate]) -> _Candidate:
    """Parts of the machine that change at once, as one link."""
    names = tuple(name for one in parts for name in one.change.names)
    columns = np.concatenate([one.columns for one in parts], axis=2)
    return _Candidate(Possible("link", names, ramps=False), columns)


@dataclass(frozen=True)
class _Step:
    """A candidate that changes at position `at` in order, or from there to `until` all along."""

    candidate: _Candidate
    at: int
    until: int | None = None

    @property
    def ramp(self) -> bool:
        """Whether it changes all along."""
        return self.until is not None

    @property
    def columns(self) -> Array:
        """(N, R, d)"""
        return self._share[:, None, None] * self.candidate.columns

    @property
    def _share(self) -> Array:
        return changed_share(np.arange(float(len(self.candidate.columns))), self.at, self.until)

    def curved(self, bends: int) -> Array:
        """(N, R, d (1 + bends)) the same, and the terms of a curve beside it."""
        from loopcal.mechanisms.effects.drift import bent  # loaded where it is used

        terms = [self._share, *bent(self._share, bends)]
        return np.concatenate([t[:, None, None] * self.candidate.columns for t in terms], axis=2)


def find_shifts(result: FitResult, *, level: float = 0.01, most: int = MOST) -> Shifts:
    """The change points of a calibration: rows, what moved, size and significance.

    Candidates are each target on the body, each instrument's place, each joint's zero and each
    instrument's own zero. level: probability of finding any where errors are independent; most:
    change points to find. Smooth functions of the joints take part with a learnt variance, so that
    an arm that bends does not look like steps where poses are measured region by region.

    Not searched are streams, and sets of fewer than 20 or more than 5,000 poses. Raises InputError
    for a level outside (0, 1).
    """
    if not 0.0 < level < 1.0:
        raise InputError(
            f"the level of a test is a probability, not {level:g}", code="invalid-value"
        )
    count = len(result.problem.poses)
    if result.all_poses is not None or not searchable(count):
        return replace(NOT_SEARCHED, level=level)
    with one_blas_thread():
        shifts, fit = Search(ordered_system(result), level).run(most)
        return replace(
            shifts,
            scales=(*scales(fit), *range_zeros(fit), *joint_scale(fit)),
            delay=pose_delay(fit),
            joint_error=joint_error(fit, level),
        )


def searchable(poses: int) -> bool:
    """Whether so many poses are searched for change points."""
    return 4 * LEAST <= poses <= MOST_POSES


def apart(point: ChangePoint, points: Sequence[ChangePoint]) -> bool:
    """Whether a change is none of these points: a step's date is uncertain by some poses."""
    alike = [other for other in points if other.shape == point.shape]
    if point.shape == "ramp":
        return all(other.names != point.names for other in alike)
    return all(abs(point.number - other.number) > LEAST for other in alike)


class Search:
    """Forward selection of steps, each placed anew when another joins."""

    def __init__(
        self,
        system: OrderedSystem,
        level: float = NOT_SEARCHED.level,
        causes: Sequence[Cause] = ALONG_A_RUN,
        least: int = LEAST,
    ) -> None:
        """least: poses between two changes, and before the first and after the last."""
        self.problem, self.level, self.system, self.least = system.problem, level, system, least
        changes = possible(self.problem, causes)
        # Stations may have unlike scales all along, which looks like a step between them.
        scaled = [column for _, column in scale_columns(system)[1:]]
        self.unlike = np.concatenate([system.Z[:, :, :0], *scaled], axis=2)
        self.candidates = [_Candidate(one, one.columns(system.columns)) for one in changes]
        steps = len(self.system.E) * sum(one.steps for one in changes)
        ramps = sum(one.ramps for one in changes)
        # Half of the level for steps, half for ramps; each shared by all of its tests (Bonferroni).
        self.tests = {False: 2.0 * max(steps, 1), True: 2.0 * max(ramps, 1)}

    def run(self, most: int = MOST) -> tuple[Shifts, Fitted]:
        """The change points in order, and the fit that has them, all stations of one scale."""
        steps, fit = list[_Step](), self.system.fitted()
        if self.unlike.shape[2]:
            fit = fit.beside(self.unlike).again()
        while len(steps) < most:
            best, log_p = self._best(fit, steps, self.candidates)
            if best is None or log_p > math.log(self.level):
                break
            # `beside` puts columns first; `_without` counts on the same order of steps.
            steps, fit = [best, *steps], fit.beside(best.columns).again()
        fit, steps = self._without_ramps(fit, steps)
        smooth = self._smooth(fit, steps)
        # Sized beside all others, before any of them leaves the fit.
        sized = [self._point(fit, steps, step) for step in smooth]
        unsure = tuple(point for point in sized if self._is_sure(point))
        for step in smooth:
            fit = self._without(fit, steps, step)
            steps.remove(step)
        fit = fit.again() if smooth else fit
        fit, steps = self._placed(fit, steps)
        points = [self._point(fit, steps, step) for step in steps]
        if any(step.ramp for step in steps) and told_by_joints(self._joints()) is not None:
            points = [replace(point, imitated=point.shape == "ramp") for point in points]
        apart = self._distinct(fit, steps)
        # What later ones made needless is no change.
        sure = [(p, s in apart) for p, s in zip(points, steps, strict=True) if self._is_sure(p)]
        order = self.system.order
        fits = fit.p_values >= UNREMARKABLE if steps else np.zeros(0, dtype=bool)
        shifts = Shifts(
            tuple(sorted((point for point, _ in sure), key=lambda point: point.number)),
            self.level,
            len(order),
            frozenset(self.problem.poses[i] for i in order[np.flatnonzero(fits)].tolist()),
            unsure,
            tuple(point for point, clear in sure if clear),
        )
        alike = fit.without(fit.further - self.unlike.shape[2], self.unlike.shape[2])
        return shifts, alike

    def _is_sure(self, point: ChangePoint) -> bool:
        """Whether it is no chance, and a change that a machine can have."""
        return point.p_value < self.level and not any(
            impossible(point.moved, one.size, one.sd, one.unit) for one in point.changes.values()
        )

    def _without(self, fit: Fitted, steps: Sequence[_Step], step: _Step) -> Fitted:
        """A fit with these steps, without one of them."""
        sizes = [one.candidate.columns.shape[2] for one in steps]
        at = steps.index(step)
        return fit.without(fit.further - self.unlike.shape[2] - sum(sizes[at:]), sizes[at])

    def _placed(self, fit: Fitted, steps: Sequence[_Step]) -> tuple[Fitted, list[_Step]]:
        """Each step at its best pose beside the others."""
        placed = [*steps]
        for step in steps:
            if not step.ramp:
                rest = self._without(fit, placed, step)
                placed.remove(step)
                new = self._best(rest, placed, [step.candidate], ramps=False)[0] or step
                placed, fit = [new, *placed], rest.beside(new.columns)
        return fit, placed

    def _without_ramps(self, fit: Fitted, steps: list[_Step]) -> tuple[Fitted, list[_Step]]:
        """Without ramps that a step, at its best pose, makes needless: of a few poses a step looks
        like a ramp at first."""
        for ramp in [step for step in steps if step.ramp]:
            rest, others = self._placed(
                self._without(fit, steps, ramp), [step for step in steps if step is not ramp]
            )
            log_p = rest.step(ramp.columns).log_p() + math.log(self.tests[True])
            if others and log_p >= math.log(self.level):
                fit, steps = rest.again(), others
        return fit, steps

    def _log_p(self, fit: Fitted, step: _Step) -> float:
        """Log of the corrected p-value of a step beside a fit without it."""
        explained = fit.step(step.columns)
        return self._tested(explained.gain, explained.rank, fit, ramp=step.ramp)

    def _tested(self, gain: float, rank: int, fit: Fitted, *, ramp: bool) -> float:
        """The same of a gain, in whatever scale the rows stand."""
        share = gain / fit.squares if fit.squares else 0.0
        spare = max(fit.spare - rank, 1.0)
        return log_share(share, rank, spare) + math.log(self.tests[ramp])

    def _distinct(self, fit: Fitted, steps: Sequence[_Step]) -> list[_Step]:
        """The steps that an error of the machine model along these poses does not look like."""
        if not steps:
            return []
        joints = self._joints()
        followed = order_by_joints(joints) if any(step.ramp for step in steps) else 1.0
        cosines = path_cosines(joints)
        smooth = self._smooth(fit, steps, cosines) if cosines > _WAVES else []
        smooth += self._played(fit, steps)
        clear = [step for step in steps if step.ramp or step not in smooth]
        if followed < FOLLOWED:
            return [s for s in clear if not s.ramp or s.candidate.change.kind in DRIFTING]
        return [step for step in clear if not step.ramp]

    def _joints(self) -> Array:
        """(N, n) in the order of the run."""
        return self.problem.readings[joint_rows(self.problem)][:, self.system.order].T

    def _smooth(self, fit: Fitted, steps: Sequence[_Step], cosines: int = _WAVES) -> list[_Step]:
        """The steps that slow changes over the run explain, beside which only an edge counts.

        These are changes of the readings, or of a joint or link itself, as a machine cools.
        """
        sudden = [step for step in steps if not step.ramp]
        if not sudden:
            return []
        waved = fit.beside(np.concatenate(self.system.waves(cosines), axis=2))
        edges = [self._without(waved, steps, step).step(step.columns) for step in sudden]
        for i, step in enumerate(sudden):
            if step.candidate.change.kind in GRADUAL:
                curve = _Step(step.candidate, *step.candidate.seen).curved(BENDS)
                beside = self._without(fit, steps, step).beside(curve).step(step.columns)
                edges[i] = max(edges[i], beside, key=lambda edge: edge.log_p(fit.spare))
        unclear = [edge.log_p(fit.spare) >= math.log(_EDGE) for edge in edges]
        return [step for step, smooth in zip(sudden, unclear, strict=True) if smooth]

    def _played(self, fit: Fitted, steps: Sequence[_Step]) -> list[_Step]:
        """The steps that play of joints explains as well: it changes sides where a raster turns."""
        played = fit.beside(self.system.play())
        return [
            step
            for step in steps
            if not step.ramp
            and self._without(played, steps, step).step(step.columns).log_p(fit.spare)
            >= math.log(_EDGE)
        ]

    def _point(self, fit: Fitted, steps: Sequence[_Step], step: _Step) -> ChangePoint:
        """One of the steps of a fit beside all others, with its size; parts of the machine that
        explain it about as well are one cause."""
        rest, spare = self._without(fit, steps, step), fit.spare
        alike = self._alike(rest, step)
        parts = [c for c in alike if c.change.kind in RARE]
        if step.candidate.change.kind in RARE and parts:
            step = replace(step, candidate=_together([step.candidate, *parts]))
            alike = [c for c in self._alike(rest, step) if c.change.kind not in RARE]
        change, bends = step.candidate.change, self._bends(fit, step)
        estimated = rest.step(step.columns)
        sized = rest.step(step.curved(bends)) if bends else estimated
        # Of a curve the line comes first, which is all of its change over the run.
        sizes = zip(change.titles, sized.size.tolist(), sized.sds.tolist(), strict=False)
        poses, order = self.problem.poses, self.system.order
        return ChangePoint(
            "ramp" if step.ramp else "step",
            poses[order[step.at]],
            poses[order[step.at - 1 if step.until is None else step.until]],
            step.at + 1,
            cast(Moved, change.kind),
            {
                name: Change(size, sd_of(size, sd, unit), unit)
                for name, size, sd in sizes
                for unit in ["1" if change.parts else unit_of(self.problem, name)]
            },
            estimated.before(spare),
            min(1.0, math.exp(estimated.log_p(spare)) * self.tests[step.ramp]),
            tuple(c.change.label or ", ".join(c.change.titles) for c in alike),
            until=None if step.until is None else step.until + 1,
            bends=bends,
            of=change.label if change.kind in ("station", "target") else "",
        )

    def _alike(self, rest: Fitted, step: _Step) -> list[_Candidate]:
        """What explains a step about as well."""
        names, log_p = {*step.candidate.change.names}, rest.step(step.columns).log_p()
        return [
            c
            for c in self.candidates
            if (c.change.ramps if step.ramp else c.change.steps)
            and not {*c.change.names} & names
            and rest.step(replace(step, candidate=c).columns).log_p() - log_p < ALIKE
        ]

    def _bends(self, fit: Fitted, step: _Step) -> int:
        """Terms of a curve that a ramp needs beside its line: all of `BENDS`, or none."""
        if not step.ramp:
            return 0
        curve = step.curved(BENDS)[:, :, step.columns.shape[2] :]
        log_p = fit.step(curve).log_p() + math.log(self.tests[True])
        return BENDS if log_p < math.log(self.level) else 0

    def _best(
        self,
        fitted: Fitted,
        steps: Sequence[_Step],
        candidates: Sequence[_Candidate],
        *,
        ramps: bool = True,
    ) -> tuple[_Step | None, float]:
        """The most significant further step, and the log of its corrected p-value."""
        N = len(self.system.E)
        free = np.zeros(N, dtype=bool)
        free[self.least : N - self.least + 1] = True
        for step in steps:
            if not step.ramp:
                free[max(step.at - self.least + 1, 0) : step.at + self.least] = False
        trials: list[tuple[float, float, _Step]] = []
        for candidate in candidates:
            change = candidate.change
            rare = RARE.get(change.kind, 0.0)
            gains, ranks = fitted.gains(candidate.columns) if change.steps else (free, 0 * free)
            # Gains of different rank cannot be compared, only their p-values.
            for rank in np.unique(ranks[free & (ranks > 0)]).tolist():
                at = int(np.argmax(np.where(free & (ranks == rank), gains, -1.0)))
                log_p = self._tested(float(gains[at]), rank, fitted, ramp=False)
                trials.append((log_p + rare, log_p, _Step(candidate, at)))
            ramp = _Step(candidate, *candidate.seen)
            if ramps and change.ramps and ramp not in steps:
                log_p = self._log_p(fitted, ramp)
                trials.append((log_p, log_p, ramp))
        if not trials:
            return None, 0.0
        _, log_p, best = min(trials, key=lambda one: one[0])
        return best, log_p
