"""The dependence of a fit's residuals: tested for every instrument, and learnt where it drifts.

Whether residuals of neighbouring poses are alike: neighbours in order, or in joint space.

For pairs of neighbours (i, j) the statistic is

    r = sum over pairs of y_i . y_j / (|E|^2 + prior),

von Neumann's ratio (1941) where neighbours follow each other, Moran's I (1950) where they are near
in joint space. It is the score test of a component that neighbours share. The fit has taken part of
the residuals; the moments of r allow for it exactly (Durbin and Watson 1950): with M the projector
onto what is left, nu its rank and K the pairs as a matrix,

    E r = tr MK / nu,   Var r = 2 (nu tr (MK)^2 - (tr MK)^2) / (nu^2 (nu + 2)).

Errors of unlike size or direction, such as those of an arm that bends, scatter r more: the variance
is at least sum (y_i . y_j)^2 / (|E|^2 + prior)^2, right for independent errors of any kind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.document.change_points import Dependence, InstrumentDependence, Likeness
from loopcal.estimation.dependence.seen import Seen, instruments, seen
from loopcal.estimation.dependence.serial import Drift, Whole, learnt_drift
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.solve.solution import Solution

# docs/decisions/0050: family-wise.
LEVEL = 0.001
# Chosen, not derived: distances by pairs grow with the square, here to 32 MB.
MOST_NEIGHBOURS = 2000
"""Poses among which neighbours in joint space are sought; of more, every second, third, ..."""
# Chosen, not derived: where poses are as few as readings, canonical correlations are 1 by
# themselves.
_PAIRED = 3
"""Poses for each reading of two instruments from which their errors are compared."""
# Chosen, not derived: a drift makes poses alike that are near in order; more leaves too few pairs.
_APART = 0.1
"""Poses closer in order than this share of all are no neighbours in joint space."""
_ROUNDING = 1e-14
"""Chi-squared per degree of freedom up to which residuals are rounding: readings without noise."""


@dataclass(frozen=True, eq=False)
class Depending:
    """entry: the tests; drifting: the drift that was learnt, None without serial dependence;
    covariance: (n, n) [SI] of the estimate under it."""

    entry: Dependence
    drifting: Drifting | None = None
    covariance: Array | None = None


@dataclass(frozen=True, eq=False)
class Drifting:
    """A drift of the errors of these readings."""

    drift: Drift
    readings: tuple[str, ...]


def dependence(
    problem: Problem, solution: Solution, equations: Sequence[PoseEquations]
) -> Depending:
    """The tests of all instruments, and the covariance where an instrument drifts.

    equations: of the poses where the fit ended.
    """
    entry, whole = _tested(problem, solution, equations)
    families = {i.instrument for i in entry.serial}
    drifting = [f for f in instruments(problem) if f.name in families]
    if not drifting:
        return Depending(entry)
    root = solution.spectrum.root
    readings = tuple(dict.fromkeys(q for f in drifting for q in f.readings))
    drifting_seen = seen(problem, equations, root, readings).take(pose_order(problem))
    drift = learnt_drift(whole, drifting_seen)
    entry = replace(entry, drift_share=drift.share, drift_poses=drift.length)
    return Depending(
        entry, Drifting(drift, readings), root @ drift.covariance(whole, drifting_seen) @ root.T
    )


def likenesses(
    problem: Problem, solution: Solution, equations: Sequence[PoseEquations]
) -> Dependence:
    """The tests of all instruments alone, as in `dependence`."""
    return _tested(problem, solution, equations)[0]


def _tested(
    problem: Problem, solution: Solution, equations: Sequence[PoseEquations]
) -> tuple[Dependence, Whole]:
    root = solution.spectrum.root
    whole = _whole(problem, solution, equations, root)
    informed = int(np.count_nonzero(problem.precision))
    freedom = whole.equations + informed - root.shape[1]
    square = whole.EE + whole.square
    families = instruments(problem)
    if not square > _ROUNDING * freedom:
        untested = tuple(InstrumentDependence(f.name, None, None) for f in families)
        return Dependence(untested, LEVEL), whole
    order = pose_order(problem)
    pairs = _spatial(problem, order)
    rows = []
    for family in families:
        family_seen = seen(problem, equations, root, family.readings)
        following = order[in_order(family_seen.take(order))]
        serial = likeness(family_seen, following, square, freedom)
        spatial = likeness(family_seen, pairs, square, freedom)
        rows.append(InstrumentDependence(family.name, serial, spatial))
    shared = _shared(problem, equations, root) if _joints_exact(problem) else None
    return Dependence(tuple(rows), LEVEL, shared=shared), whole


def covariance_under(
    drifting: Drifting,
    problem: Problem,
    solution: Solution,
    equations: Sequence[PoseEquations],
) -> Array:
    """(n, n) [SI] of an estimate under a drift that is known."""
    root = solution.spectrum.root
    whole = _whole(problem, solution, equations, root)
    drifting_seen = seen(problem, equations, root, drifting.readings).take(pose_order(problem))
    return np.asarray(root @ drifting.drift.covariance(whole, drifting_seen) @ root.T)


def pose_order(problem: Problem) -> NDArray[np.intp]:
    """(N,) the poses as they were measured: by the known time if there is one, else by row."""
    times = [i for i, q in enumerate(problem.mechanism.pose_constants.values()) if q == "s"]
    if len(times) != 1:
        return np.arange(len(problem.poses))
    return np.argsort(problem.pose_constants[times[0]], kind="stable")


def _whole(
    problem: Problem, solution: Solution, equations: Sequence[PoseEquations], root: Array
) -> Whole:
    k = root.shape[1]
    DD, DE, EE, count = np.zeros((k, k)), np.zeros(k), 0.0, 0
    for block in equations:
        D, E = rows_times(block.D, root).reshape(-1, k), block.E.ravel()
        DD, DE, EE, count = (
            DD + D.T @ D,
            DE + D.T @ E,
            EE + float(E @ E),
            count + int(block.count.sum()),
        )
    precision = problem.precision
    away = problem.nominal - solution.parameters[problem.free]
    pull = np.where(precision > 0.0, precision * away, 0.0)
    P, square = root.T @ (precision[:, None] * root), float(pull @ away)
    return Whole(DD, DE, EE, P, root.T @ pull, square, count)


def _joints_exact(problem: Problem) -> bool:
    """Whether the fit gives the joints no noise, which all instruments would see, and all of them
    are read, or follow by closed loops: what instruments alone determine makes their residuals
    alike."""
    mechanism, sd = problem.mechanism, problem.uncertainty.sd
    seen_by = {loop for family in mechanism.families for loop in family.loops}
    closed = len({*mechanism.tape.loops} - seen_by)
    unread = int(np.isinf(sd).any(axis=1).sum())
    return problem.loops_alike or (unread <= closed and not sd[joint_rows(problem)].any())


def _shared(problem: Problem, equations: Sequence[PoseEquations], root: Array) -> Likeness | None:
    """Whether residuals of two instruments in one pose are independent (Bartlett 1938).

    The largest canonical correlation of any pair, and the p-value after Bonferroni.
    """
    every = [seen(problem, equations, root, f.readings) for f in instruments(problem)]
    tests = []
    for a, b in combinations(every, 2):
        both = a.read & b.read
        n, p, q = int(np.count_nonzero(both)), a.y.shape[1], b.y.shape[1]
        if n < _PAIRED * (p + q):
            continue
        X, Y = a.y[both] - a.y[both].mean(axis=0), b.y[both] - b.y[both].mean(axis=0)
        r = np.linalg.svd(np.linalg.qr(X)[0].T @ np.linalg.qr(Y)[0], compute_uv=False)
        # Residuals that are copies have r = 1, whose logarithm is not finite.
        left = 1.0 - np.square(np.minimum(r, 1.0 - 1e-12))
        # Bartlett's factor: n - 1 - (p + q + 1) / 2.
        square = -(n - 0.5 * (p + q + 3)) * float(np.log(left).sum())
        tests.append((tail(max(square, 0.0), p * q), float(r[0])))
    if not tests:
        return None
    p_value, correlation = min(tests, key=lambda one: (one[0], -one[1]))
    return Likeness(correlation, min(1.0, len(tests) * p_value))


def joint_rows(problem: Problem) -> list[int]:
    """The quantities by which a pose is a place: measured, but not by an instrument."""
    mechanism = problem.mechanism
    read = {q for f in mechanism.families for q in f.readings} | {*mechanism.outputs}
    aside = read | {*mechanism.disturbances}
    hidden = set(np.flatnonzero(np.isinf(problem.uncertainty.sd).any(axis=1)).tolist())
    names = mechanism.tape.quantities
    return [i for i, q in enumerate(names) if q not in aside and i not in hidden]


def _spatial(problem: Problem, order: NDArray[np.intp]) -> Pairs:
    """The neighbours in joint space, of what no instrument reads: angles on the circle, lengths by
    their spread."""
    mechanism, names = problem.mechanism, problem.mechanism.tape.quantities
    rows = joint_rows(problem)
    if not rows:
        return np.zeros((2, 0), dtype=np.intp)
    order = order[:: -(-len(order) // MOST_NEIGHBOURS)]
    points = []
    for i in rows:
        readings = problem.readings[i, order]
        if mechanism.quantities[names[i]] == "rad":
            points += [np.cos(readings), np.sin(readings)]
        else:
            points.append((readings - readings.mean()) / max(float(readings.std()), 1e-300))
    return order[near(np.array(points).T, apart=int(_APART * len(order)))]


Pairs = NDArray[np.intp]
# Chosen, not derived: with fewer, the normal distribution of Moran's I is not to be believed.
_LEAST = 10
"""Degrees of freedom and pairs that a test needs at least."""


def in_order(seen: Seen) -> Pairs:
    """(2, p) the poses that follow each other among those that were read."""
    read = np.flatnonzero(seen.read)
    return np.array([read[:-1], read[1:]])


def likeness(seen: Seen, pairs: Pairs, square: float, freedom: int) -> Likeness | None:
    """The test for these pairs; None where there is too little to test.

    seen: in directions z of the parameters with D^T D + P = I; square: |E|^2 and that of the prior;
    freedom: nu.
    """
    i, j = pairs[:, seen.read[pairs].all(axis=0)]
    if freedom < _LEAST or len(i) < _LEAST or not square > 0.0:
        return None
    y, A, M = seen.y, seen.A, seen.M
    products = np.einsum("pq,pq->p", y[i], y[j])
    total = float(products.sum())
    N, q, k = A.shape
    near = _added_up(A, np.r_[i, j], np.r_[j, i])
    once = A.reshape(N * q, k).T @ near.reshape(N * q, k)
    twice = float(np.einsum("nqi,nqi->", near, M @ near))
    # M = 1 - D D^T, and K pairs different poses: of tr MK only -tr D^T K D is left.
    trace = -float(np.trace(once))
    # tr (MK)^2 = tr K^2 - 2 tr D^T K^2 D + tr (D^T K D)^2; a pair is in K twice, as 1/2.
    squared = 0.5 * float(np.einsum("pqr,prq->", M[i], M[j])) - 2.0 * twice
    squared += float(np.square(once).sum())
    variance = 2.0 * (freedom * squared - trace**2) / (freedom**2 * (freedom + 2.0))
    variance = max(variance, float(products @ products) / square**2)
    if not variance > 0.0:
        return None
    deviate = (total / square - trace / freedom) / math.sqrt(variance)
    mean_square = float(np.einsum("nq,nq->", y, y)) / int(seen.read.sum())
    correlation = total / len(i) / mean_square if mean_square > 0.0 else 0.0
    # One-sided: errors that neighbours share make residuals alike, never unlike.
    return Likeness(correlation, 0.5 * math.erfc(deviate / math.sqrt(2.0)))


def _added_up(A: Array, to: NDArray[np.intp], of: NDArray[np.intp]) -> Array:
    """(N, q, k) the sum over pairs of A[of] / 2, by `to`; add.at takes five times as long."""
    added = np.zeros_like(A)
    order = np.argsort(to, kind="stable")
    to, of = to[order], of[order]
    first = np.searchsorted(to, to)
    place = np.arange(len(to)) - first
    for turn in range(int(place.max(initial=-1)) + 1):
        now = place == turn  # one pair of each pose: += of more would keep the last alone
        added[to[now]] += A[of[now]]
    return np.asarray(0.5 * added)


def near(points: Array, neighbours: int = 6, apart: int = 0) -> Pairs:
    """(2, p) pairs of poses that are nearest to each other at points (N, d).

    apart: poses that follow each other within so many are no pair. A drift along a path is then
    not taken for a place in joint space.
    """
    N = len(points)
    if 2 * apart + 2 >= N:
        return np.zeros((2, 0), dtype=np.intp)
    squares = np.square(points).sum(axis=1)
    distance = squares[:, None] + squares - 2.0 * points @ points.T
    rows = np.arange(N)
    distance[np.abs(rows[:, None] - rows) <= apart] = np.inf
    nearest = np.argpartition(distance, min(neighbours, N - 1), axis=1)[:, :neighbours]
    both = np.sort(np.array([np.repeat(rows, nearest.shape[1]), nearest.ravel()]), axis=0)
    kept = np.isfinite(distance[both[0], both[1]])
    return np.array(np.divmod(np.unique(both[0, kept] * N + both[1, kept]), N))
