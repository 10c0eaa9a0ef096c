"""The search for faults of a whole file: in another unit, reversed, exchanged, displaced, shuffled.

Such a file cannot be calibrated at all, and no single pose is to blame. Each repair is tried on the
machine as drawn, placed as well as can be; the one that brings it much nearer to the readings is
suspected. It is verified by fits of all parameters, with the fault and without it: a machine with
many parameters bends itself to a fault too, but never better than to the readings as they should
be. Where no repair helps and the machine as drawn explains next to nothing, that is the fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import ColumnFault
from loopcal.document.plain import finite
from loopcal.errors import InputError, listed
from loopcal.estimation.faults.misfit import (
    HALF,
    STAYS,
    beside,
    complete,
    fit_of_all,
    left_in,
    misfit,
    missed,
    mounting,
    reach,
    shrunk,
    undrawn,
    unread,
)
from loopcal.estimation.problem.alignment import can_be_placed, seen_points
from loopcal.estimation.problem.constants import standing
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.lazy import cached_property
from loopcal.mechanisms.mechanism import PIXELS, Family
from loopcal.presentation.shown import enumerated, size, unit_shown, with_unit

if TYPE_CHECKING:
    from loopcal.estimation.faults.repairs import Repair

# This, PLAUSIBLE and MUCH_BETTER: docs/decisions/0052, measured by analyses/file_faults.py.
NEAR = 0.01
"""A drawing that misses the readings by this share of their spread, or less, raises no question."""
PLAUSIBLE = 0.1
"""A repair must leave no larger share."""
MUCH_BETTER = 1 / 3
"""A fault is suspected if undoing it leaves at most this of the misfit."""
# Chosen, not derived: as PLAUSIBLE, but a share of the misfit.
SURE = 0.1
"""A repair that leaves at most this of the misfit needs no fit to verify it. A fit would mislead:
it shrinks a machine whose readings are all in another unit as well as it fits the right one."""
# Chosen, not derived: 1 % is beyond what rounding and the last steps of a fit change.
BETTER = 0.99
"""The fit of all parameters must improve by at least this factor, a fit that was the very measure
of the suspicion by MUCH_BETTER: a repair that changes nothing proves nothing."""
# Chosen, not derived: wider names two repairs where one is right, narrower one by chance.
EQUAL = 1.05
"""Repairs whose misfits differ by less than this factor cannot be told apart."""
# Points that have nothing to do with the machine miss by about their spread (1): chosen, not
# derived, between that and PLAUSIBLE.
NOTHING = 0.3
"""A drawing that misses the better half of the poses by this share of their spread describes
another machine, or another file."""
UNREPAIRED = ("rows-shuffled", "wrong-machine")
"""Codes of faults that no repair proves: a fit may yet show that only the drawing is far off."""
# Chosen, not derived: above the scatter of quantiles of some hundred points.
SAME = 0.05
"""Two sets of points have the same shape if the quantiles of their distances differ by less."""
# Chosen, not derived: the share of a run that may be outliers.
FEW = 0.1
"""Single poses are found among the others; of more than this share the file is at fault."""
HELD = "held-point"
"""Code of an instrument to which a machine held one point."""
MOST_READ, MOST_UNREAD = 1000, 200
"""So many repairs are tried, the second where each takes a search for what nobody reads: at most
some ten seconds of one core, whatever the machine."""
# Poses of a trial, of a first glance, and of one that searches unread quantities; faults of one
# file; steps of a fit of all and of a first glance; repairs that are looked at twice. Chosen, not
# derived: they bound the time, and `analyses.file_faults` counts what is then named.
_SAMPLE, _FEW, _FEWEST, _MOST, _STEPS, _FIRST, _BEST = 120, 40, 10, 3, 15, 3, 8


def column_faults(
    problem: Problem, *, suspected: bool = True, stated: bool = True
) -> tuple[ColumnFault, ...]:
    """The faults of a whole file, the gravest first.

    suspected: whether something else than the drawing speaks for a fault already; otherwise they
    are only sought where the machine as drawn misses the readings by more than a drawing and their
    noise may; stated: the sds say what that is, because none of them is learnt.
    """
    file = _File(complete(problem), stated)
    if any(f.form == PIXELS for f in problem.mechanism.families):
        return ()  # faults of images are those of single ones, or were found with their start
    if not (suspected or file.suspicious) or file.blind:
        return ()  # loops that unread quantities close meet altered readings as well
    still = file.still
    if still:
        return still
    faults: list[ColumnFault] = []
    for _ in range(_MOST):
        fault = _gravest(file, repaired=bool(faults))
        if fault is None:
            break
        repair, column_fault = fault
        faults.append(column_fault)
        file = _File(repair.problem, stated)
    return tuple(faults) or _hopeless(file)


def suspicious(problem: Problem, *, stated: bool = True) -> bool:
    """Whether `column_faults` would seek any where nothing but the drawing speaks for a fault."""
    return _File(complete(problem), stated).suspicious


@dataclass(frozen=True, eq=False)
class _File:
    """The readings of a problem as they stand, and what the machine as drawn says of them.

    stated: whether the sds say how large their noise is.
    """

    problem: Problem
    stated: bool

    @cached_property
    def seen(self) -> list[tuple[Family, Array, Array]]:
        """The points that the machine as drawn computes, and those that were measured."""
        return seen_points(self.problem, self.problem.start)

    @cached_property
    def some(self) -> Problem:
        """A sample of the poses."""
        return _thinned(self.problem, _SAMPLE)

    @cached_property
    def left(self) -> float:
        """The misfit of the sample."""
        return misfit(self.some).share

    @cached_property
    def limit(self) -> float:
        """The misfit of the sample that a repair must leave at most."""
        return min(MUCH_BETTER * self.left, PLAUSIBLE)

    def may_mend(self, repair: Repair) -> bool:
        """Whether a repair may leave so little: what it does not alter misses as much as before.

        Of a drawing that is near, so that one step tells.
        """
        if shrunk(repair.problem) and not shrunk(self.problem):
            return False  # a machine that all but stands still fits anything
        if self.left > PLAUSIBLE or unread(self.problem):
            return True
        altered = {*repair.quantities}
        tape, families = self.problem.mechanism.tape, self.problem.mechanism.families
        inputs = dict(zip(tape.loops, self._inputs, strict=True))
        met = [f for f in families if any(inputs[loop] & altered for loop in f.loops)]
        readings = {q for f in met for q in f.readings}
        beside = tuple(i for i, of in enumerate(self._inputs) if not of & (altered | readings))
        return not beside or self._left_in(beside) <= self.limit

    @cached_property
    def _inputs(self) -> tuple[frozenset[str], ...]:
        """What each loop contains."""
        return self.problem.mechanism.tape.depends_on()

    @cached_property
    def _left_in(self) -> Callable[[tuple[int, ...]], float]:
        return left_in(self.some)

    @cached_property
    def blind(self) -> bool:
        """Whether loops close whatever the readings, or no point that is seen can be computed."""
        if unread(self.problem) and not can_be_placed(self.problem.mechanism):
            return True
        return bool(self.seen) and all(
            np.isnan(computed).any(axis=0).all() for _, computed, _ in self.seen
        )

    @property
    def suspicious(self) -> bool:
        """Whether the machine as drawn misses the readings by more than a drawing and noise may.

        Always without what the drawing does not state: a machine of which nothing says what is
        drawn and what is not gives no measure before its fit.
        """
        if not undrawn(self.problem.mechanism):
            return False
        if unread(self.problem) and self.blind:
            return False
        near = NEAR + mounting(self.some)
        return missed(self.some, near, noisy=self.stated) and not self.blind

    @property
    def still(self) -> tuple[ColumnFault, ...]:
        """Instruments that read the same in every pose, although the machine moves there."""
        faults = []
        outputs = self.problem.mechanism.outputs
        for family, computed, measured in self.seen:
            if family.form not in ("point", "pose") or measured.shape[1] < 10:
                continue
            if np.isnan(computed).all():  # an instrument of the calibration that is not there today
                continue
            names = [q for q in family.readings if q in outputs][: len(measured)]
            spread = np.nanmax(np.nanstd(computed, axis=1))
            for name, predicted, read in zip(names, computed, measured, strict=True):
                away = float(np.nanstd(predicted))
                if np.isfinite(read).all() and np.ptp(read) == 0.0 and away > NEAR * spread:
                    words = f"{name} reads the same value in every pose, although the machine moves"
                    unit = self.problem.mechanism.quantities[name]
                    faults.append(ColumnFault((name,), words, away, None, True, "constant", unit))
            rows = repeating(computed, measured, NEAR * spread)
            if not faults and len(rows) > FEW * measured.shape[1]:
                held = [self.problem.poses[i] for i in rows]
                words = not_read_again(names, held, measured.shape[1])
                faults.append(ColumnFault(tuple(names), words, spread, None, True, "constant", "m"))
            places = family.placement is not None
            if places and all(_held(self.problem, p) for p in (computed, measured)):
                within = 2.0 * float(np.nanmax(np.nanstd(measured, axis=1)))
                words = (
                    f"{enumerated(names)} stay within {with_unit(within, 'm')} although the joints "
                    "move: the machine held one point, so nothing says where the instrument stands"
                )
                faults.append(ColumnFault(tuple(names), words, within, None, True, HELD, "m"))
        return tuple(faults)


def repeating(computed: Array, measured: Array, least: float) -> NDArray[np.intp]:
    """The poses whose points (c, N) repeat those before, although the machine moved by more."""
    repeated = (np.diff(measured, axis=1) == 0.0).all(axis=0)
    moved = np.linalg.norm(np.diff(computed, axis=1), axis=0) > least
    return np.flatnonzero(repeated & moved) + 1


def not_read_again(names: Sequence[str], held: Sequence[str], poses: int) -> str:
    """That readings of these names repeat those before in these poses, of so many."""
    verb = "repeats" if len(names) == 1 else "repeat"
    return (
        f"{', '.join(names)} {verb} the row before to the last digit in {len(held)} of {poses} "
        f"poses, although the joints moved the machine ({listed(held, 5)}): the instrument was not "
        "read again"
    )


def _thinned(problem: Problem, most: int) -> Problem:
    N = problem.count
    if most >= N:
        return problem
    return taken(problem, np.unique(np.linspace(0, N - 1, min(N, most)).round().astype(np.intp)))


def _gravest(file: _File, *, repaired: bool) -> tuple[Repair, ColumnFault] | None:
    problem, before = file.problem, file.left
    if repaired and before <= NEAR:
        return None
    few = _FEWEST if unread(problem) else _FEW
    tried = _tried(file).repairs
    share = _roughly(problem, before, few)
    first = [(share(_thinned(r.problem, few)), r) for r in tried]
    least = min((share for share, _ in first), default=math.inf)
    if math.isinf(least) or not least < before:
        return None
    order = np.argsort([share for share, _ in first], kind="stable")[:_BEST]
    near = [(misfit(_thinned(first[i][1].problem, _SAMPLE)).share, i) for i in order]
    least = min(share for share, _ in near)
    if not least <= file.limit:
        return None
    alike = [first[i][1] for i in sorted(i for share, i in near if share <= EQUAL * least)]
    after, now = misfit(alike[0].problem), misfit(problem)
    drawn = bool(undrawn(problem.mechanism))
    if not (drawn and least <= SURE * before):
        limit = (BETTER if drawn else MUCH_BETTER) * _fitted(problem, after.good)
        alike = [repair for repair in alike if _fitted(repair.problem, after.good) <= limit]
    if not alike:
        return None
    best = alike[0]
    quantities = tuple(dict.fromkeys(name for repair in alike for name in repair.quantities))
    words = " or ".join(repair.words for repair in alike)
    fault = ColumnFault(
        quantities,
        words,
        finite(now.size),
        after.size,
        drawn,
        best.code,
        now.unit,
    )
    return best, fault


def _roughly(problem: Problem, before: float, few: int) -> Callable[[Problem], float]:
    """The misfit of some poses, after a few steps at most.

    Of a drawing that fits the readings as they stand, what repairs leave is linear: a repair that
    moves them much leaves more.
    """
    sample = _thinned(problem, few)
    near = beside(sample) if before <= NEAR and not unread(problem) else None

    def share(some: Problem) -> float:
        if near is not None and some.poses == sample.poses:  # displaced rows are other poses
            return near(some)
        return misfit(some, 1, _FIRST).share

    return share


@dataclass(frozen=True, eq=False)
class _Tried:
    """The repairs that are tried, and how many there are."""

    repairs: list[Repair]
    count: int

    @property
    def words(self) -> str:
        """What was not tried; empty where all were."""
        left = self.count - len(self.repairs)
        what = "exchanged or altered columns"
        return (
            f"; {left:,} of {self.count:,} possible faults ({what}) were not tried" if left else ""
        )


def _tried(file: _File) -> _Tried:
    """As many repairs as time allows: of exchanged columns, whose pairs are many, what is left."""
    from loopcal.estimation.faults.repairs import repairs

    every = [repair for repair in repairs(file.problem) if file.may_mend(repair)]
    most = MOST_UNREAD if unread(file.problem) else MOST_READ
    order = sorted(range(len(every)), key=lambda i: every[i].code == "exchanged")
    return _Tried([every[i] for i in sorted(order[:most])], len(every))


def _fitted(problem: Problem, good: NDArray[np.intp]) -> float:
    # A repair of displaced rows has fewer poses than the file.
    good = good[good < problem.count]
    return fit_of_all(_thinned(taken(problem, good), _SAMPLE), _STEPS)


def _hopeless(file: _File) -> tuple[ColumnFault, ...]:
    """The fault where no repair helps and the machine as drawn explains next to nothing."""
    problem = file.problem
    if not undrawn(problem.mechanism):
        return ()
    left = misfit(_thinned(problem, _SAMPLE), kept=HALF)
    if not left.share > NOTHING:
        return ()
    names = tuple(q for q in problem.mechanism.outputs)
    how = f"{size(left.size, left.unit)} {unit_shown(left.unit)}".removesuffix(" 1")
    if problem.mechanism.orientations and _same_shape(problem, in_order=True):
        turns = tuple(n for o in problem.mechanism.orientations for n in o.columns)
        words = (
            f"the points belong to these poses row by row, but the orientations in "
            f"{enumerated(turns)} do not: another convention, order, unit or sign"
        )
        return (ColumnFault(turns, words, finite(left.size), None, True, "orientation", left.unit),)
    if _same_shape(problem):
        words = (
            "the readings of the instrument belong to these poses, but in another order (shuffled "
            f"rows, or ids that do not match){_tried(file).words}"
        )
        return (
            ColumnFault(names, words, finite(left.size), None, True, "rows-shuffled", left.unit),
        )
    causes = "another robot type, or joint readings of another file"
    quantities = problem.mechanism.tape.quantities
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    still = standing(problem.mechanism, problem.readings)
    stuck = [repr(quantities[i]) for i in still if np.isfinite(sd[i]).any()]
    if stuck:
        it_reads = "it reads" if len(stuck) == 1 else "they read"
        causes = (
            f"perhaps {enumerated(stuck)} moved, but {it_reads} the same in every pose; or {causes}"
        )
    words = (
        f"the nominal machine does not describe these readings: wherever it is placed, half of the "
        f"poses are more than {how} off; {causes}{_tried(file).words}"
    )
    return (ColumnFault(names, words, finite(left.size), None, True, "wrong-machine", left.unit),)


def _same_shape(problem: Problem, *, in_order: bool = False) -> bool:
    """Whether computed and measured points are alike as sets, whatever belongs to what; in_order:
    pose by pose.

    Compared are the distances between the points of each set, which no motion changes; or their
    quantiles, which no order changes.
    """
    some = _thinned(problem, _SAMPLE)
    try:
        seen = seen_points(some, some.start)
    except InputError:
        return False
    quantiles = np.linspace(0.05, 0.95, 19)
    for _, computed, measured in seen:
        good = np.isfinite(computed).all(axis=0) & np.isfinite(measured).all(axis=0)
        if good.sum() < 10:
            return False
        one, other = (_between(p[:, good]) for p in (computed, measured))
        if not in_order:
            one, other = np.quantile(one, quantiles), np.quantile(other, quantiles)
        # Single poses that do not fit are no other order.
        if np.quantile(np.abs(one - other), 0.9 if in_order else 1.0) > SAME * other.max():
            return False
    return bool(seen)


def _held(problem: Problem, points: Array) -> bool:
    """Whether points (c, N) lie all but in one place, as in a test of rotary axes."""
    points = points[:, np.isfinite(points).all(axis=0)]
    return points.shape[1] > 0 and float(np.std(points, axis=1).max()) <= STAYS * reach(problem)


def _between(points: Array) -> Array:
    gaps = points[:, :, None] - points[:, None, :]
    first, second = np.triu_indices(points.shape[1], 1)
    distances: Array = np.sqrt(np.square(gaps).sum(axis=0))[first, second]
    return distances
