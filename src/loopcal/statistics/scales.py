"""Scales and zeros of what was measured: of stations beside the first, of all beside the drawing.

A station whose lengths are 1 + s times too long reads (1 + s) p instead of p. Its column in the
whitened equations, sum_q p_q C_q of its readings q, stands beside those of all parameters:

    s = (u^T W u)^-1 u^T W e,   sd(s) = (u^T W u)^-1/2,   W = Q - U H^-1 U^T,

e the equations, H with the priors of the parameters. Stations are compared with the first. A scale
of all of them is that of the machine's lengths, and shows only beside the sds by which these keep
to the drawing, or beside slides, which are read. With z = s / sd, z^2 is chi-squared where these
are stated. Where they are learnt from k lengths, the scale is in what they were learnt from, as in
a regression of the errors of lengths on the lengths: z^2 / k is the share of squares that it
explains, and (k - 1) z^2 / (k - z^2) is F(1, k - 1). Of the information 1 / sd^2 the priors of the
lengths give only a share w, slides the rest, and of z^2 likewise: (k - w) z^2 / (k - w z^2) is
taken as F(1, (k - 1) / w^2), as variances of sums are (Satterthwaite 1946).

The column stands at the readings, whose noise, 1 in each of m whitened equations, is in the column
too. It draws s towards 1 by m sd^2, which is less than sd only where sd < 1 / m.

A wrong constant of a prism or reflector is a zero of all distances: an instrument at the origin of
its frame that reads every distance c too long reads p + c p / |p| instead of p. Its column is
sum_q (p_q / |p|) C_q. A scale grows with the distance and a shift of the station is alike in all
directions, so distances and directions that differ separate the three.

A joint with another gear ratio, or another count of lines, has true angles (1 + s) q. Its column
q c, c that of the zero, stands beside c times cos q, sin q, cos 2q and sin 2q without any prior:
over a small range a gear out of round looks the same, and then s is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.dependence.seen import instruments
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.effects.effect import STATION_SCALES
from loopcal.mechanisms.effects.station_scales import by_station, lengths_read
from loopcal.mechanisms.mechanism import Family
from loopcal.small_samples import f_tail
from loopcal.statistics.ordered_system import Fitted, OrderedSystem

# Far above rounding, 1e-16 times the condition of the products. Chosen, not derived.
_ABSORBED = 1e-10
"""Of the square of a column, what is left beside all else, below which it is rounding."""
# Chosen, not derived: the lengths of two or three links are never so much in proportion.
_LEFT = 0.01
"""Least share of the squares of lengths that a scale leaves."""
# Chosen, not derived: less is no scale that anybody would look for.
_EXPLAINED = 0.1
"""Least share of the squares that are left, which the scale of a joint explains."""
_READ = {"point": slice(None), "spherical": slice(1), "polar": slice(1)}
"""By the form of an instrument: those of its readings that change with the distance."""


def scales(fit: Fitted) -> tuple[ScaleEntry, ...]:
    """The scales of a calibration, each with its sd and the p-value of one that is not there.

    Those that are in the fit are tested as if they were not.
    """
    fit, system = fit.held(fit.system.problem.mechanism.effects.get(STATION_SCALES, ())), fit.system
    stations = scale_columns(system)
    spreads = [_spread(system.problem, families) for families, _ in stations]
    entries = [
        _entry(fit, column, [f.name for f in families], spread)
        for (families, column), spread in zip(stations[1:], spreads[1:], strict=True)
    ]
    learnt = _learnt_lengths(system.problem)
    if stations and learnt is not None and len(learnt) != 1:
        every = np.sum([column for _, column in stations], axis=0)
        entries.append(_entry(fit, every, [], max(spreads), learnt))
    return tuple(one for one in entries if one is not None)


def scale_columns(system: OrderedSystem) -> list[tuple[list[Family], Array]]:
    """The instruments of each station, and the column (N, R, 1) of their scale."""
    seen = {family.name for family in instruments(system.problem)}
    groups = [[f for f in one if f.name in seen] for one in by_station(system.problem.mechanism)]
    return [(families, _column(system, families)) for families in groups if families]


def _column(system: OrderedSystem, families: list[Family]) -> Array:
    """(N, R, 1) of a scale that is larger by one."""
    problem = system.problem
    names = lengths_read(families)
    rows = [problem.mechanism.tape.quantities.index(q) for q in names]
    read = np.nan_to_num(problem.readings[rows][:, system.order].T)
    return np.asarray(np.einsum("nrq,nq->nr", system.columns(names), read)[:, :, None])


def _learnt_lengths(problem: Problem) -> list[int] | None:
    """Positions of the lengths that share a learnt sd; none where sds are stated, None without
    any."""
    free = {p.name: p for p in problem.mechanism.parameters if p.name in problem.names}
    lengths = {n for n, p in free.items() if p.role == "length" and p.dimension == "length"}
    for term in problem.mechanism.learnt_terms:
        if members := lengths & {*term.parameters}:
            return [problem.names.index(n) for n in sorted(members)]
    at = [problem.names.index(n) for n in lengths if free[n].nominal]
    return [] if at and (problem.precision[at] > 0.0).all() else None


def _spread(problem: Problem, families: list[Family]) -> float:
    """Rms distance [m] of the points from their mean; of ranges, from theirs."""
    squares = []
    for family in families:
        names = lengths_read([family])
        rows = [problem.mechanism.tape.quantities.index(q) for q in names]
        read = [r[np.isfinite(r)] for r in problem.readings[rows]]
        squares.append(float(sum(np.var(r) for r in read if r.size)))
    return math.sqrt(max(squares, default=0.0))


def _entry(
    fit: Fitted, column: Array, names: list[str], spread: float, learnt: Sequence[int] = ()
) -> ScaleEntry | None:
    found = fit.step(column, _ABSORBED)
    if not found.rank:
        return None
    (size,), (sd,) = found.size.tolist(), found.sds.tolist()
    if sd > 1.0 / fit.system.equations.sum():
        return None
    square, freedom = found.before(fit.spare), math.inf
    if learnt:
        k, share = len(learnt), min(fit.kept_by(column, learnt) * sd**2, 1.0)
        square *= (k - share) / max(k - share * square, _LEFT * k)
        freedom = (k - 1.0) / max(share, 1e-9) ** 2
    p_value = f_tail(square, 1, freedom)
    return ScaleEntry(tuple(names), size, sd, p_value, abs(size) * spread)


def scale_of_all(problem: Problem, size: float, sd: float) -> ScaleEntry:
    """The scale of all that is measured beside an earlier calibration, of this size and sd."""
    p_value = f_tail((size / sd) ** 2, 1, math.inf)
    return ScaleEntry((), size, sd, p_value, abs(size) * _spread(problem, [*instruments(problem)]))


def range_zeros(fit: Fitted) -> tuple[ScaleEntry, ...]:
    """By station the distance that is read too long, with the p-value of one that is not there."""
    seen = {family.name for family in instruments(fit.system.problem)}
    entries = []
    for station in by_station(fit.system.problem.mechanism):
        families = [f for f in station if f.name in seen]
        if not families or any(f.form not in _READ for f in families):
            continue
        column, spread = _zero_column(fit.system, families)
        found = fit.step(column, _ABSORBED)
        if math.isfinite(spread) and found.rank:
            (size,), (sd,) = found.size.tolist(), found.sds.tolist()
            p_value = f_tail(found.before(fit.spare), 1, math.inf)
            names = tuple(f.name for f in families)
            entries.append(ScaleEntry(names, size, sd, p_value, abs(size) * spread, "m"))
    return tuple(entries)


def joint_scale(fit: Fitted) -> tuple[ScaleEntry, ...]:
    """That of the joint whose angles are likeliest in proportion too large or small, its p-value
    corrected for the search; none that explains little of what is left."""
    system, entries = fit.system, []
    problem = system.problem
    quantities = problem.mechanism.tape.quantities
    joints = [
        i for i in joint_rows(problem) if problem.mechanism.quantities[quantities[i]] == "rad"
    ]
    for i in joints:
        q = problem.readings[i, system.order][:, None, None]
        zero = system.columns([quantities[i]])
        waves = zero * np.concatenate([f(m * q) for m in (1, 2) for f in (np.cos, np.sin)], axis=2)
        every = np.concatenate([waves, zero * q], axis=2)
        less, more = fit.step(waves, _ABSORBED), fit.step(every, _ABSORBED)
        gained = more.before(fit.spare) - less.before(fit.spare)
        if more.rank > less.rank and gained > _EXPLAINED * fit.spare:
            size, sd = float(more.size[-1]), float(more.sds[-1])
            p_value = min(1.0, f_tail(gained, 1, math.inf) * len(joints))
            turned = abs(size) * float(q.std())
            entries.append(ScaleEntry((), size, sd, p_value, turned, joint=quantities[i]))
    return tuple(sorted(entries, key=lambda one: one.p_value)[:1])


def _zero_column(system: OrderedSystem, families: list[Family]) -> tuple[Array, float]:
    """(N, R, 1) of distances one metre too long, and the rms by which it moves points about their
    mean [m]; infinite where the frame cannot be the instrument's own."""
    problem, total, spread = system.problem, 0.0, 0.0
    for family in families:
        names = list(family.readings[_READ[family.form]])
        rows = [problem.mechanism.tape.quantities.index(q) for q in names]
        read = problem.readings[rows][:, system.order]
        if family.form == "point":
            if _among(read):
                spread = math.inf
            read = read / np.linalg.norm(read, axis=0)
            spread = max(spread, math.sqrt(float(np.nanvar(read, axis=1).sum())))
        else:
            read, spread = np.ones_like(read), max(spread, 1.0)
        total = total + np.einsum("nrq,qn->nr", system.columns(names), np.nan_to_num(read))
    return np.asarray(total)[:, :, None], spread


def _among(points: Array) -> bool:
    """Whether the origin lies among points (c, N), as that of a machine does: instruments stand
    outside its reach."""
    middle = np.nanmean(points, axis=1, keepdims=True)
    away = np.linalg.norm(points - middle, axis=0)
    return bool(np.linalg.norm(middle) <= np.nanmax(away))
