"""How far the machine as drawn is from its readings, whatever instrument made them.

Only what no drawing states is estimated: where instruments stand, and where on the machine their
targets are. The misfit has no unit: what an instrument read counts as shares of its spread, angles
in rad. It is that of nine tenths of the poses, found by repetition (least trimmed
squares, Rousseeuw 1984), so that gross errors in single poses neither make a fault nor hide one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.accuracy import by_pose, deviations
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.alignment import align, can_be_placed, placed_values, seen_points
from loopcal.estimation.problem.problem import Problem, Weighting, taken
from loopcal.estimation.residuals import residuals
from loopcal.estimation.solve.solver import solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.outputs import points

# docs/decisions/0052 for the first.
MOST, HALF = 0.9, 0.5
"""Shares of the poses that decide: gross errors are few. Of a grid driven row by row whose readings
stand one row late, the better half shows nothing but a constant shift."""
GROSS = 10.0
"""A pose this many times farther off than half of them takes no part in verifying a fault."""
# One over the normal distribution's quantile of 3/4.
NORMAL = 1.4826
"""The sd of normal values, over the median of their distances from the middle."""
# Chosen, not derived: rounds of leaving poses aside, and steps of each. A placement in closed form
# is near.
_ROUNDS, _STEPS = 3, 10
# As in docs/decisions/0046.
_MOUNTED = 5e-3
"""By how much [m] what is mounted on a body may be off the drawing."""
# Chosen, not derived: below what machines are calibrated in, above how far they miss a point.
STAYS = 0.01
"""Points within this share of the machine's lengths are one that it held while its joints moved:
how far they spread is its error, not how large its motions are."""
_SPREAD = ("point", "pose", "spherical", "polar", "length")
"""Forms of readings whose own spread says how large the machine's motions are."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """Of the better part of the poses.

    share: as it is compared; size: the same in `unit`, for the reader; away: (N,) the share of
    every pose, NaN where nothing was read.
    """

    share: float
    size: float
    unit: str
    away: Array

    @property
    def good(self) -> NDArray[np.intp]:
        """Positions of the poses that no gross error bends."""
        middle = float(np.nanmedian(self.away)) if np.isfinite(self.away).any() else math.inf
        return np.flatnonzero(~(self.away > GROSS * middle))


def undrawn(mechanism: Mechanism) -> tuple[str, ...]:
    """The parameters that say where instruments stand and what they look at, where known."""
    return tuple(
        p.name for p in mechanism.parameters if not p.fixed and p.role in ("placement", "mounting")
    )


def misfit(
    problem: Problem, rounds: int = _ROUNDS, steps: int = _STEPS, kept: float = MOST
) -> Misfit:
    """The misfit of the nominal machine, infinite where no loop closes.

    Every parameter takes part where nothing says which of them the drawing does not state.
    rounds: how often the better poses are found anew; steps: of each fit, at most; kept: which
    share of the poses these are.
    """
    scales = _scales(problem)
    away = np.full(problem.count, np.nan)
    try:
        find = _apart(problem, scales) if unread(problem) else _misplaced(problem, scales, steps)
        away = find(None)
        if not np.isfinite(away).any():
            return Misfit(math.inf, math.inf, scales.unit, away)
        for _ in range(rounds):
            away = find(_better(away, kept))
        good = _better(away, kept)
        share = float(np.sqrt(np.square(away[good]).mean())) if good.size else math.inf
    except InputError:
        share = math.inf
    share = share if math.isfinite(share) else math.inf
    return Misfit(share, share * scales.size, scales.unit, away)


def _better(away: Array, kept: float) -> NDArray[np.intp]:
    return np.flatnonzero(away <= _quantile(away, kept))


def _quantile(away: Array, kept: float) -> float:
    """The misfit that this share of the poses keeps to; NaN where none has any.

    As `np.nanquantile` with the method "higher": between poses, one of them infinite, interpolation
    would give NaN. A repair is one of hundreds, and this a tenth of its time there.
    """
    some = away[~np.isnan(away)]
    if not some.size:
        return math.nan
    at = math.ceil(kept * (some.size - 1))
    return float(np.partition(some, at)[at])


def unread(problem: Problem) -> bool:
    """Whether loops must find what nobody reads before anything can be compared."""
    return any(pattern.unmeasured for pattern in problem.patterns)


def complete(problem: Problem) -> Problem:
    """The poses in which all that moves the machine was read, where these are most of them: loops
    that find what is missing take it from the readings that they are to judge."""
    if not unread(problem):
        return problem
    some = [np.arange(problem.count)[p.poses] for p in problem.patterns if not p.unmeasured]
    rows = np.sort(np.concatenate([np.array([], dtype=np.intp), *some]))
    return taken(problem, rows) if len(rows) >= HALF * problem.count else problem


_Find = Callable[[NDArray[np.intp] | None], Array]
"""Shares (N,) once the machine was placed by some of the poses; None: as it begins."""


def _misplaced(problem: Problem, scales: _Scales, steps: int) -> _Find:
    """Instruments and targets are fitted."""
    names = undrawn(problem.mechanism) or problem.names
    parameters = _begun(problem)

    def find(some: NDArray[np.intp] | None) -> Array:
        nonlocal parameters
        if some is not None:
            parameters = _fitted(taken(problem, some), parameters, names, steps)
        return scales.shares(problem, parameters)

    return find


def _apart(problem: Problem, scales: _Scales) -> _Find:
    """Where loops find what nobody reads, they do so once; then the points are aligned."""
    seen = seen_points(problem, problem.start)

    def find(some: NDArray[np.intp] | None) -> Array:
        squares = np.zeros(problem.count)
        for _, computed, measured in seen:
            part = slice(None) if some is None else some
            motion = align(computed[:, part], measured[:, part])
            away = motion.rotation @ computed + motion.shift[:, None] - measured
            squares += np.square(away / scales.size).sum(axis=0)
        return np.where(np.isfinite(squares), np.sqrt(squares), np.inf)

    return find


def beside(problem: Problem) -> Callable[[Problem], float]:
    """What other readings of these poses leave, one step from where the nominal machine stands.

    Only for readings that it nearly fits, and others that are as near: one evaluation of the loops
    instead of a fit. Infinite where no loop closes.
    """
    try:
        linear, start = _placed(problem, _scales(problem))
    except InputError:
        return lambda other: math.inf

    def share(other: Problem) -> float:
        e = np.array(list(residuals(other, start).values())) / _scales(other).loops
        return linear.left(np.where(np.isfinite(e), e, 0.0).T)

    return share


def left_in(problem: Problem) -> Callable[[tuple[int, ...]], float]:
    """The share that the nominal machine leaves in some of the loops (by position), placed by these
    alone, to first order; 0 where no loop closes."""
    try:
        linear, _ = _placed(problem, _scales(problem))
    except InputError:
        return lambda loops: 0.0
    return cache(lambda loops: linear.only(loops).left())


def _placed(problem: Problem, scales: _Scales) -> tuple[_Linear, Array]:
    """The loops where most poses place the nominal machine, and all parameters there."""
    names = undrawn(problem.mechanism) or problem.names
    find = _misplaced(problem, scales, _STEPS)
    good = _better(find(None), MOST)
    start = _fitted(taken(problem, good), _begun(problem), names, _STEPS)
    return _Linear.at(problem, start, names, scales), start


def mounted(problem: Problem) -> Problem:
    """The problem, begun where most poses place instruments and targets."""
    try:
        _, start = _placed(problem, _scales(problem))
    except InputError:
        return problem
    names = problem.mechanism.parameters.names
    values = dict(zip(names, start.tolist(), strict=True))
    return problem.with_nominal(problem.mechanism.with_nominal(values))


def mounting(problem: Problem) -> float:
    """The share that what is mounted on a body may be off, where it is not fitted."""
    return _MOUNTED / _scales(problem).size if unread(problem) else 0.0


def at_start(problem: Problem) -> float:
    """The share that most poses keep to at the start, without any fit: an upper bound."""
    try:
        away = _scales(problem).shares(problem, problem.start)
    except InputError:
        return math.inf
    if not np.isfinite(away).any():
        return math.inf
    return _quantile(away, MOST)


def missed(problem: Problem, near: float, *, noisy: bool) -> bool:
    """Whether the nominal machine, placed as well as can be, misses the readings by a larger share.

    noisy: by one that also exceeds what noise of the sds makes, to first order. Most often one
    linear step from where the machine stands shows that it does not.
    """
    scales, limit = _scales(problem), near
    if not unread(problem):
        try:
            away = scales.shares(problem, problem.start)
            if _least(away) <= near:
                return False
            names = undrawn(problem.mechanism) or problem.names
            linear = _Linear.at(problem, problem.start, names, scales)
            limit = math.hypot(near, _least(linear.noise)) if noisy else near
            moved = problem.start.copy()
            moved[linear.free] += linear.step(linear.loops, _better(away, MOST))
            if _least(scales.shares(problem, moved)) <= limit:
                return False
        except InputError:
            pass
    return not misfit(problem).share <= limit


def _least(away: Array) -> float:
    """Root mean square over the better part of the poses; infinite where none is known."""
    if not np.isfinite(away).any():
        return math.inf
    good = _better(away, MOST)
    share = math.sqrt(float(np.square(away[good]).mean()))
    return share if math.isfinite(share) else math.inf


@dataclass(frozen=True, eq=False)
class _Linear:
    """The scaled loops (N, m) at some parameters, and their change (N, m, n) with some of them.

    free: (n,) positions of these; noise: (N,) shares from the noise of the readings alone.
    """

    free: NDArray[np.intp]
    loops: Array
    columns: Array
    noise: Array

    @classmethod
    def at(
        cls, problem: Problem, parameters: Array, names: tuple[str, ...], scales: _Scales
    ) -> _Linear:
        """At parameters (n_all,), by the named ones."""
        index = [problem.names.index(n) for n in names]
        values = np.zeros((problem.count, len(scales.loops)))
        columns = np.zeros((*values.shape, len(names)))
        sd = np.where(np.isfinite(problem.uncertainty.sd), problem.uncertainty.sd, 0.0)
        sd = np.broadcast_to(sd, problem.readings.shape)
        sweeper, noise = Sweeper(problem), np.full(problem.count, np.nan)
        for pattern, block in sweeper.blocks(parameters):
            loop_values = sweeper.loop_values(pattern, block)
            rows = np.array(pattern.loops, dtype=np.intp)
            by = scales.loops[rows]
            at = np.ix_(np.arange(problem.count)[block.poses], rows)
            values[at] = (loop_values.f / by).T
            columns[at] = (loop_values.by_parameter[index] / by).transpose(2, 1, 0)
            by_noise = loop_values.by_quantity * sd[:, None, block.poses] / by
            noise[block.poses] = np.sqrt(np.square(by_noise).sum(axis=(0, 1)))
        return cls(problem.free[index], values, columns, noise)

    def only(self, loops: tuple[int, ...]) -> _Linear:
        """Some of the loops."""
        some = list(loops)
        return replace(self, loops=self.loops[:, some], columns=self.columns[:, some])

    def left(self, loops: Array | None = None) -> float:
        """The share that a step leaves in most poses of these loops (N, m), by default its."""
        left = e = self.loops if loops is None else loops
        for _ in range(_ROUNDS):
            away = np.sqrt(np.square(left).sum(axis=1))
            if not np.isfinite(away).all():
                return math.inf
            good = _better(away, MOST)
            left = np.asarray(e + self.columns @ self.step(e, good))
        return float(np.sqrt(np.square(left[good]).sum(axis=1).mean()))

    def step(self, loops: Array, good: NDArray[np.intp]) -> Array:
        """The step (n,) that brings these loops (N, m) nearest to zero in some poses.

        Loops without a derivative, as a distance of zero, have no part in it.
        """
        J, missing = self.columns[good].reshape(-1, len(self.free)), -loops[good].ravel()
        finite = np.isfinite(J).all(axis=1) & np.isfinite(missing)
        return np.asarray(np.linalg.lstsq(J[finite], missing[finite], rcond=None)[0], dtype=float)


def fit_of_all(problem: Problem, iterations: int) -> float:
    """Rms share after a least-squares fit of all parameters, begun at the placed machine."""
    try:
        parameters = _fitted(problem, _begun(problem), problem.names, iterations)
        away = _scales(problem).shares(problem, parameters)
    except InputError:
        return math.inf
    finite = away[np.isfinite(away)]
    return float(np.sqrt(np.square(finite).mean())) if finite.size else math.inf


def _begun(problem: Problem) -> Array:
    if not can_be_placed(problem.mechanism):
        return problem.start
    return np.array([*placed_values(problem)[0].values()])


def _fitted(problem: Problem, start: Array, names: tuple[str, ...], iterations: int) -> Array:
    """All parameters after a least-squares fit of some of them, from a start (n_all,)."""
    index = np.array([problem.names.index(n) for n in names], dtype=np.intp)
    part = replace(
        problem,
        start=start,
        free=problem.free[index],
        nominal=problem.nominal[index],
        prior_sd=np.full(len(index), math.inf),
        weighting=Weighting.ALIKE,
    )
    return solve(part, max_iterations=iterations).parameters


@dataclass(frozen=True, eq=False)
class _Scales:
    """loops: (m, 1) what a loop's value is divided by; size, unit: of a share for the reader."""

    loops: Array
    size: float
    unit: str

    def shares(self, problem: Problem, parameters: Array) -> Array:
        """(N,) root mean square of the scaled loop values over what was read in a pose."""
        if unread(problem):
            return self._predicted(problem, parameters)
        scaled = np.array(list(residuals(problem, parameters).values())) / self.loops
        finite = np.isfinite(scaled)
        squares = np.where(finite, np.square(scaled), 0.0).sum(axis=0)
        return np.where(finite.any(axis=0), np.sqrt(squares), np.nan)

    def _predicted(self, problem: Problem, parameters: Array) -> Array:
        """The same of the outputs alone, where loops find what nobody reads; inf if they do not."""
        mechanism = problem.mechanism
        measured = problem.readings[
            [mechanism.tape.quantities.index(q) for q in mechanism.compared]
        ]
        distances = by_pose(
            deviations(mechanism, measured, output_differences(problem, parameters))
        )
        if distances is None:
            return np.full(problem.count, np.nan)
        return np.where(np.isfinite(distances), distances / self.size, np.inf)


def _scales(problem: Problem) -> _Scales:
    mechanism = problem.mechanism
    size = reach(problem)
    whole = Family("", mechanism.tape.loops, mechanism.outputs)
    families = mechanism.families or (whole,)
    units = {
        loop: mechanism.quantities.get(loop, "m" if mechanism.families else "")
        for family in families
        for loop in family.loops
    }
    other = {loop for loop, unit in units.items() if unit not in ("m", "rad")}
    swing = _swing(problem) if other else {}
    scale: dict[str, float] = {}
    spreads: list[tuple[float, str]] = []
    for family in families:
        spread = _spread(problem, family)
        if not spread > STAYS * size:
            spread = size or 1.0
        for loop in family.loops:
            usual = swing.get(loop, spread) if loop in other else spread
            scale[loop] = 1.0 if units[loop] == "rad" else usual
        read = [mechanism.quantities.get(q, "") for q in family.readings]
        if "m" in read:
            spreads.append((spread, "m"))
        elif read:
            spreads.append((scale[family.loops[0]] if read[0] != "rad" else 1.0, read[0]))
    loops = np.array([[scale.get(loop, size or 1.0)] for loop in mechanism.tape.loops])
    spreads.sort(key=lambda entry: entry[1] != "m")
    return _Scales(loops, *(spreads[0] if spreads else (1.0, "1")))


def reach(problem: Problem) -> float:
    """How large the machine is [m]: the root of the squares of the lengths that are drawn, and of
    the sds of what its slides read."""
    mechanism, drawn = problem.mechanism, _drawn(problem.mechanism)
    lengths = [p.nominal for p in mechanism.parameters if p.unit == "m" and p.name in drawn]
    seen = {q for family in mechanism.families for q in family.readings}
    for q, values in zip(mechanism.tape.quantities, problem.readings, strict=True):
        if mechanism.quantities[q] == "m" and q not in {*seen, *mechanism.outputs}:
            lengths.append(float(np.std(values)))
    return math.hypot(*lengths)


def shrunk(problem: Problem) -> bool:
    """Whether some instrument reads all points in one place, as the machine is large."""
    size = reach(problem)
    spreads = [_spread(problem, family) for family in problem.mechanism.families]
    return any(0.0 < spread <= STAYS * size for spread in spreads)


def _swing(problem: Problem) -> dict[str, float]:
    """How far the spread of the outputs moves each loop that contains one, in the loop's unit.

    The median of |df / d outputs * their spreads| over the poses, at the start. The spread is that
    of the middle of the readings, so that a few steep ones do not count.
    """
    mechanism = problem.mechanism
    names, loops = mechanism.tape.quantities, mechanism.tape.loops
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    spread = np.zeros(len(names))
    for row in [names.index(q) for q in mechanism.outputs]:
        read = problem.readings[row][np.isfinite(sd[row])]
        if read.size:
            middle = float(np.median(np.abs(read - np.median(read))))
            spread[row] = NORMAL * middle if middle else float(np.std(read))
    moved = np.full((len(loops), problem.count), np.nan)
    sweeper = Sweeper(problem)
    for pattern, block in sweeper.blocks(problem.start):
        slopes = sweeper.loop_values(pattern, block).by_quantity
        at = np.ix_(np.array(pattern.loops), np.arange(problem.count)[block.poses])
        moved[at] = np.sqrt(np.square(slopes * spread[:, None, None]).sum(axis=0))
    finite = {loop: row[np.isfinite(row)] for loop, row in zip(loops, moved, strict=True)}
    medians = {loop: float(np.median(row)) for loop, row in finite.items() if row.size}
    return {loop: size for loop, size in medians.items() if size > 0.0}


def _drawn(mechanism: Mechanism) -> frozenset[str]:
    """The parameters that the drawing states, or all."""
    every = frozenset(mechanism.parameters.names)
    return every - frozenset(undrawn(mechanism)) or every


def _spread(problem: Problem, family: Family) -> float:
    """Median distance [m] of what an instrument read from its middle; 0 where it reads none."""
    mechanism = problem.mechanism
    names = mechanism.tape.quantities
    coordinates = [
        q for q in family.readings if mechanism.quantities[q] == "m" or family.form in _SPREAD
    ]
    if family.form == "pose":
        coordinates = [q for q in coordinates if mechanism.quantities[q] == "m"]
    if not coordinates or family.form not in _SPREAD:
        return 0.0
    rows = [names.index(q) for q in coordinates]
    hidden = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows])
    read = points(family, np.where(hidden, np.nan, problem.readings[rows]))
    read = read[:, np.isfinite(read).all(axis=0)]
    if not read.size:
        return 0.0
    middle = np.median(read, axis=1, keepdims=True)
    return float(np.median(np.sqrt(np.square(read - middle).sum(axis=0))))
