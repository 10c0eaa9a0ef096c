"""Where the search for unmeasured quantities begins: from home, and from elsewhere if need be.

The loops are solved for what is unmeasured, from its place holder (a value between neighbours, or
the mechanism's home). They may close with several angles, and be near closing with others: a few
poses are therefore searched from many angles. If the place holders did as well in all of these,
other starts are tried only for poses whose loops close worse than theirs; otherwise for every
pose. A home says more: how the machine is assembled. Unless it is wrong altogether it is left in
those poses only in which it did far worse than in others.

Points read so far off that no machine of this size can have been there.

A number that stands for a missing reading, a lost decimal point or a damaged file: a fit would be
about this pose alone, and its loops could not be closed. Smaller gross errors are for the tests
of outliers, which name the reading to blame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.alignment import seen_points
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.presentation.shown import significant

# Every 30 degrees. Chosen, not derived: more starts find more ways to stand, for as much more time.
_ROUND = 12
# Chosen, not derived: as many as _ROUND bounds for one angle, more for several; each costs a
# search.
_MOST, _MOST_FROM_HOME = 72, 24
"""Starts for several angles, without and with a home among them."""
# Chosen, not derived: a pose stays in the form of home unless another one is clearly better.
_FAR_BETTER = 0.25
_ELSEWHERE = 1e-3
"""Home is taken for wrong where elsewhere most poses close with so much of its misfit or less. One
redundant reading closes by chance in some of a platform's forty ways to stand, if not in most."""
# Chosen, not derived: every such pose costs a search.
_ASTRAY = 100.0
"""A pose that home leaves with so many times the usual misfit may stand elsewhere."""
# Chosen, not derived: enough to say where most poses close.
_SAMPLE = 32
"""Poses of each pattern that are searched from everywhere."""


def start_corrections(sweeper: Sweeper, parameters: Array) -> Array:
    """Corrections (k, N) [SI] to begin from, zero but for unmeasured quantities."""
    problem = sweeper.problem
    units, names = problem.mechanism.quantities, problem.mechanism.tape.quantities
    best = np.zeros(problem.readings.shape)  # no memory yet, where nothing is unmeasured
    for pattern in problem.patterns:
        angles = [i for i in pattern.unmeasured if units[names[i]] == "rad"]
        if not angles and not any(names[i] in problem.mechanism.home for i in pattern.unmeasured):
            continue  # lengths are found from anywhere
        poses = np.arange(len(problem.poses))[pattern.poses]
        near = (
            None
            if problem.first_corrections is None
            else _unread(pattern, problem.first_corrections[:, poses])
        )
        if pattern.predicted:  # of an image the known constants of the pose say where its board is
            if near is not None:
                best[:, poses] = near
            continue
        home = _Searched.of(sweeper, pattern, poses, parameters, near)
        best[:, poses] = home.corrections
        if not angles or near is not None:
            continue
        at_home = any(names[i] in problem.mechanism.home for i in angles)
        turns = _offsets(len(angles), _MOST_FROM_HOME if at_home else _MOST)[1:]
        some = np.unique(np.linspace(0, len(poses) - 1, _SAMPLE).astype(np.intp))
        sample = home.taken(some).from_elsewhere(sweeper, angles, turns)
        if at_home and not np.median(sample.misfit) < _ELSEWHERE * np.median(home.misfit[some]):
            rest = home.misfit > _ASTRAY * np.median(home.misfit)
        else:
            best[:, sample.poses] = sample.corrections
            astray = (sample.misfit < home.misfit[some]).any()
            rest = np.ones(len(poses), dtype=bool) if astray else home.misfit > sample.misfit.max()
            rest[some] = False
        for part in _parts(np.flatnonzero(rest), max(problem.block // len(turns), 1)):
            other = home.taken(part).from_elsewhere(sweeper, angles, turns)
            best[:, other.poses] = other.corrections
    return best


@dataclass(frozen=True)
class _Searched:
    """Some poses (b,) of a pattern, corrections (k, b) of theirs, and the misfit left (b,)."""

    pattern: Pattern
    poses: NDArray[np.intp]
    parameters: Array
    corrections: Array
    misfit: Array

    @classmethod
    def of(
        cls,
        sweeper: Sweeper,
        pattern: Pattern,
        poses: NDArray[np.intp],
        parameters: Array,
        start: Array | None = None,
    ) -> _Searched:
        """What the loops say from a start (k, b), by default the readings' place holders."""
        corrections = np.zeros((len(sweeper.problem.readings), len(poses)))
        misfit = np.empty(len(poses))
        for part in _parts(np.arange(len(poses)), sweeper.problem.block):
            begun = corrections[:, part] if start is None else start[:, part]
            block = sweeper.searched(
                pattern, sweeper.block(pattern, poses[part], parameters, begun)
            )
            corrections[:, part] = block.corrections
            misfit[part] = sweeper.misfit(pattern, block)
        return cls(pattern, poses, parameters, corrections, misfit)

    def taken(self, index: NDArray[np.intp]) -> _Searched:
        """Those at these positions."""
        return replace(
            self,
            poses=self.poses[index],
            corrections=self.corrections[:, index],
            misfit=self.misfit[index],
        )

    def from_elsewhere(self, sweeper: Sweeper, angles: list[int], turns: list[Array]) -> _Searched:
        """The same poses searched from turned angles too; the first start keeps its right."""
        b, all_turns = len(self.poses), np.array(turns)
        start = np.zeros((len(self.corrections), len(turns) * b))
        start[angles] = np.repeat(all_turns.T, b, axis=1)
        tried = _Searched.of(
            sweeper, self.pattern, np.tile(self.poses, len(turns)), self.parameters, start
        )
        misfits = tried.misfit.reshape(len(turns), b)
        best = misfits.argmin(axis=0)
        least = misfits[best, np.arange(b)]
        # The 1e-9 keeps a pose that closes already where it is, whatever rounding says.
        better = least < _FAR_BETTER * self.misfit - 1e-9
        return replace(
            self,
            corrections=np.where(
                better, tried.corrections[:, best * b + np.arange(b)], self.corrections
            ),
            misfit=np.where(better, least, self.misfit),
        )


def _unread(pattern: Pattern, corrections: Array) -> Array:
    """These corrections (k, b), zero but for what the pattern leaves unmeasured."""
    kept = np.zeros_like(corrections)
    kept[list(pattern.unmeasured)] = corrections[list(pattern.unmeasured)]
    return kept


def _parts(index: NDArray[np.intp], size: int) -> Iterator[NDArray[np.intp]]:
    for begin in range(0, len(index), size):
        yield index[begin : begin + size]


def _offsets(angles: int, most: int) -> list[Array]:
    """Starts for some angles [rad], the first of them none at all; at most so many."""
    if angles == 1:
        return [np.array([2 * np.pi * i / _ROUND]) for i in range(_ROUND)]
    # Points of an additive recurrence (Roberts 2018) fill the torus evenly in any dimension.
    # `root` solves x^(angles + 1) = x + 1, the golden ratio for one angle.
    root = 1.5
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (angles + 1))
    steps = root ** -np.arange(1.0, angles + 1)
    return [2 * np.pi * ((i * steps) % 1.0) for i in range(most)]


# docs/decisions/0052 for the first.
_FAR, _LONG, _FEW, _NAMED = 30.0, 10.0, 0.1, 5


def refuse_unreachable(problem: Problem, parameters: Array) -> None:
    """Raise InputError for points measured where the machine cannot be.

    That is 30 times as far from the computed point, in some coordinate, as half of all points are
    from the instrument's origin. Where this holds of more than a tenth of the poses, the machine
    or a unit is wrong, which others report better.

    parameters: (n_all,) where the machine stands as measured, at least roughly.
    """
    if not _long(problem):
        return
    for family, computed, measured in seen_points(problem, parameters):
        complete = np.isfinite(computed).all(axis=0) & np.isfinite(measured).all(axis=0)
        if not complete.any():
            continue
        size = float(np.median(np.abs(measured[:, complete]).max(axis=0)))
        off = np.where(complete, np.abs(computed - measured).max(axis=0), 0.0)
        far = np.flatnonzero(off > _FAR * size)
        if not 0 < len(far) <= _FEW * complete.sum():
            continue
        names = [q for q in family.readings if q in problem.mechanism.outputs]
        words = [
            f"pose {problem.pose(int(i))!r} ({', '.join(names)} place the point "
            f"{significant(off[i], 3)} m from the machine's prediction)"
            for i in far[:_NAMED]
        ]
        more = f" and {len(far) - _NAMED} more" if len(far) > _NAMED else ""
        raise InputError(
            f"implausible readings: {'; '.join(words)}{more}; half of the points have all "
            f"coordinates within {significant(size, 3)} m",
            code="implausible-readings",
            remedy="correct or blank these readings, or exclude the poses (data.exclude)",
        )


def _long(problem: Problem) -> bool:
    """Whether any length read is so large that points are worth computing to be compared."""
    units = problem.mechanism.quantities
    lengths = [i for i, q in enumerate(problem.mechanism.tape.quantities) if units[q] == "m"]
    longest = np.fmax.reduce(np.abs(problem.readings[lengths]), axis=0, initial=0.0)
    return bool(longest.max(initial=0.0) > _LONG * np.median(longest))
