"""Repeats of a pose that share its error: they count as one reading, their mean.

A machine that returns to a pose repeats most of its error there: that of a joint's reading, of its
gears, and of what the model lacks. Repeats then scatter by the instrument alone, and many of them
say no more of the machine than one. The test is that of lack of fit (Fisher 1922; Draper and Smith
1998, chapter 2). A fit of the means of the poses g, n_g repeats each, whitens their
equations, r of each pose, by X. If each repeat erred for itself, the variance of one would be n_g
times that of the mean. Of its deviation d_gi [SI] from the mean readings

    S = sum_gi |X_g d_gi|^2 / n_g,   f = r sum_g (n_g - 1),

S / f would be F-distributed with f and the degrees of freedom that the fit has left; shared errors
make it less. On another day the calibration states the sds of one reading, X whitens by them, and S
without n_g would be chi-squared.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.document.findings import RepeatsEntry
from loopcal.estimation.problem.pose_equations import PoseEquations, pose_equations
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.effects.backlash import directions
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.case import Case, taken
from loopcal.statistics.folds import Index, Scheme, grouped, may_repeat, repeated, stated_sds

# Chosen, not derived: of a thousand sets whose repeats err for themselves, one is averaged.
LEVEL = 1e-3
"""Repeats share an error where chance explains how well they agree with less probability."""
# Chosen, not derived: a pose that is read again at the middle and at the end shows a drift.
MANY = 0.25
"""Share of the rows from which on repeats that are apart hide how much poses err."""
# As in `changed`: what is larger than stated by half.
MUCH = 1.5
"""Poses leave so many times what repeats scatter where sds are too small."""
# Chosen, not derived: an angle that jumps by a turn, or a sign that changes, has no mean.
_FAR = 0.1
"""Repeats of a reading lie within this share of its span."""


def same_poses(
    mechanism: Mechanism, data: Dataset, noise: Noise | None, within: Index | None = None
) -> Index:
    """A number for each row (N,), equal for repeats of a pose, in the order of their first ones.

    Repeats have the same loads and temperatures, and readings of the same instruments. within: of
    rows that are not to be joined, such as those of two sessions.
    """
    keys = [repeated(mechanism, data, stated_sds(noise, mechanism, data))]
    keys += [] if within is None else [within]
    times = {q for q, si in mechanism.pose_constants.items() if si == "s" or q in mechanism.latest}
    for q in ({*_read(mechanism), *mechanism.pose_constants} - times) & {*data.readings}:
        values, gaps = data.readings[q], np.isnan(data.readings[q])
        keys.append(gaps.astype(np.intp))
        span = float(np.ptp(values[~gaps])) if not gaps.all() else 0.0
        if span > 0.0:
            first = _first(keys[0])[keys[0]]
            steps = (np.nan_to_num(values) - np.nan_to_num(values[first])) / (_FAR * span)
            keys.append(np.rint(0.5 * steps).astype(np.intp))
    _, first, of = np.unique(np.array(keys), axis=1, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[of.ravel()], dtype=np.intp)


def following(groups: Index) -> Index:
    """Of groups (N,) only rows that follow each other: repeats apart show what happened between."""
    return np.cumsum(np.diff(groups, prepend=groups[0]) != 0)


def _read(mechanism: Mechanism) -> set[str]:
    """What instruments read that have means; none of images, of orientations, or where it counts
    from which side a joint came."""
    families = mechanism.families
    if mechanism.orientations or any(family.form == PIXELS for family in families):
        return set()
    if directions(mechanism):
        return set()
    return {*mechanism.outputs, *(q for family in families for q in family.readings)}


@dataclass(frozen=True, eq=False)
class Means:
    """A case and its scheme with repeats of a pose as one reading.

    rows: all readings; groups: (N,) the pose of each row.
    """

    case: Case
    scheme: Scheme | None
    rows: Dataset
    groups: Index

    @classmethod
    def each(cls, case: Case, scheme: Scheme | None) -> Iterator[Means]:
        """Repeats that follow each other, then also those that do not, where they are many; none of
        a case whose rows copy others."""
        read, stated = _read(case.mechanism), None if scheme is None else scheme.groups
        sds = stated_sds(case.noise, case.mechanism, case.data)
        if not read or case.copied.size or not may_repeat(case.mechanism, case.data, sds):
            return
        within = None if stated is None else grouped(case.mechanism, case.data, stated)
        poses = same_poses(case.mechanism, case.data, case.noise, within)
        near = following(poses)
        again = len(poses) - int(poses.max()) - 1
        many = again >= MANY * len(poses) and poses.max() < near.max()
        for groups in [*([near] if near.max() + 1 < len(near) else []), *([poses] if many else [])]:
            first = _first(groups)
            means = averaged(case.data, groups, read)
            made = replace(case, data=means, noise=taken(case.noise, first))
            yield cls(made, None if scheme is None else scheme.of(first), case.data, groups)

    def shared(self, whole: FitResult) -> bool:
        """Whether repeats share an error, by the fit of the means."""
        from scipy.special import fdtr

        if whole.problem.count != len(self.case.data):
            return False
        equations, root = whole.pose_equations(), whole.solution.spectrum.root
        number = np.bincount(self.groups).astype(float)
        away = _deviations(whole.problem.mechanism, self.rows, self.case.data, self.groups)
        square = _square(equations, away, self.groups, number)
        count = np.zeros(len(number))
        for block in equations:
            count[block.poses] = block.E.shape[1]
        freedom = float(count @ (number - 1.0))
        left = sum(block.E.size - float(np.square(block.D @ root).sum()) for block in equations)
        return left >= 1.0 and bool(fdtr(freedom, left, square / freedom) < LEVEL)


def shared_by_repeats(result: FitResult, noise: Noise) -> RepeatsEntry | None:
    """Repeats of a pose that share an error, in a fit that counts each row as independent.

    Of the whitened equations E_gi of a pose g with n_g rows, r each, and their means E_g,

        F = (sum_g n_g |E_g|^2 / f) / (sum_gi |E_gi - E_g|^2 / (r sum_g (n_g - 1))),

    f what the fit leaves of the equations of means. None where F is no larger than chance and sds
    that are too small by half allow, in images, and where no pose is repeated.
    """
    from scipy.special import fdtrc

    problem = result.problem
    mechanism, data = problem.mechanism, result.dataset
    if not result.status.converged or not _read(mechanism) or problem.count != len(data):
        return None
    groups = same_poses(mechanism, data, noise)
    number = np.bincount(groups)
    if number.max() < 2:
        return None
    root = result.solution.spectrum.root
    within = between = left = 0.0
    freedom = 0
    for block in result.pose_equations():
        rows = groups[block.poses]
        means = np.zeros((len(number), block.E.shape[1]))
        np.add.at(means, rows, block.E)
        counts = np.bincount(rows, minlength=len(number))
        means /= np.maximum(counts, 1)[:, None]
        within += float(np.square(block.E - means[rows]).sum())
        between += float((counts * np.square(means).sum(axis=1)).sum())
        freedom += block.E.shape[1] * int((counts[counts > 0] - 1).sum())
        left += block.E.size - float(np.square(block.D @ root).sum())
    spare = left - freedom
    if freedom < 1 or spare < 1.0 or not within > 0.0:
        return None
    F = (between / spare) / (within / freedom)
    p_value = float(fdtrc(spare, freedom, F))
    if p_value >= LEVEL or F < MUCH**2:
        return None
    return RepeatsEntry(len(data) - len(number), float(np.sqrt(F)), p_value)


def _first(groups: Index) -> Index:
    """Positions of the first row of each pose."""
    return np.unique(groups, return_index=True)[1]


def _deviations(mechanism: Mechanism, data: Dataset, means: Dataset, groups: Index) -> Array:
    """(k, N) [SI] of readings from the means of their poses; 0 where there is none."""
    made = np.zeros((len(mechanism.tape.quantities), len(data)))
    for i, q in enumerate(mechanism.tape.quantities):
        if q in data.readings:
            made[i] = np.nan_to_num(data.readings[q] - means.readings[q][groups])
    return made


def _square(
    equations: Sequence[PoseEquations], deviations: Array, groups: Index, number: Array
) -> float:
    """The sum of |X d|^2 / number over the rows of the poses of these equations."""
    square = 0.0
    for block in equations:
        position = np.full(len(number), -1)
        position[block.poses] = np.arange(len(block.poses))
        rows = np.flatnonzero(position[groups] >= 0)
        moved = np.einsum("brk,kb->br", block.X[position[groups[rows]]], deviations[:, rows])
        square += float((np.square(moved).sum(axis=1) / number[groups[rows]]).sum())
    return square


def day_as_means(
    calibrated: Calibrated,
    data: Dataset,
    noise: Noise | None,
    remounted: bool | Sequence[str] = False,
    *,
    apart: bool = False,
) -> tuple[Dataset, Noise | None]:
    """Readings of another day and their noise, with repeats that share an error as one reading.

    apart: also those that do not follow each other, of a day on which nothing moved.
    """
    mechanism, read = calibrated.mechanism, _read(calibrated.mechanism)
    if not read:
        return data, noise
    groups = same_poses(mechanism, data, noise)
    groups = groups if apart else following(groups)
    if groups.max() + 1 == len(groups):
        return data, noise
    means = averaged(data, groups, read)
    placed = Day.of(calibrated, data, noise, remounted).placed()
    equations = pose_equations(placed.problem, placed.parameters, placed.corrections)
    count = np.zeros(len(data), dtype=np.intp)
    for block in equations:
        count[block.poses] = block.E.shape[1]
    first = _first(groups)
    freedom = int(count.sum() - count[first].sum())
    away = _deviations(placed.problem.mechanism, data, means, groups)
    each = np.arange(len(data))
    square = _square(equations, away, each, np.ones(len(data))) / calibrated.factor
    if tail(square, freedom) <= 1.0 - LEVEL:
        return data, noise
    words = (
        f"{len(data) - len(means)} rows repeat a pose and share its error: each pose counts once, "
        "with the mean of its readings."
    )
    source = replace(means.source, read_as=" ".join(filter(None, [data.source.read_as, words])))
    return replace(means, source=source), taken(noise, first)


def averaged(data: Dataset, groups: NDArray[np.intp], read: Collection[str]) -> Dataset:
    """The poses of the same group (N,) as one, by the means of their readings.

    read: those whose errors are independent, so that a mean of n has the variance sd^2 / n; of all
    others repeats share one error. A pose keeps the id of its first row.
    """
    _, first, of = np.unique(groups, return_index=True, return_inverse=True)
    single = np.ones(len(data))

    def mean(values: Array, weights: Array = single) -> Array:
        number = np.bincount(of, weights * np.isfinite(values))
        sums = np.bincount(of, weights * np.nan_to_num(values))
        means = np.divide(sums, number, out=np.full(len(first), np.nan), where=number > 0.0)
        # Equal readings stay equal to the last digit: a joint that stands still is known by that.
        alike = np.bincount(of, values != values[first][of]) == 0
        return np.asarray(np.where(alike, values[first], means))

    independent = {*read} & {*data.readings}
    counts = {q: data.counts.get(q, single) * np.isfinite(data.readings[q]) for q in independent}
    gone = tuple(data.poses[i] for i in np.setdiff1d(np.arange(len(data)), first))
    source = replace(
        data.source,
        rows_read=data.source.rows_read or len(data),
        averaged=(*data.source.averaged, *gone),
        judged=True,
    )
    return replace(
        replace(data, source=source).take(first),
        readings={q: mean(v, counts.get(q, single)) for q, v in data.readings.items()},
        sds={q: np.sqrt(mean(np.square(v))) for q, v in data.sds.items()},
        counts={q: np.maximum(np.bincount(of, number), 1.0) for q, number in counts.items()},
    )
