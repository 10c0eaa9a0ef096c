"""Faults of whole columns: exchanged, in another unit, or counted the other way round.

Such a file cannot be calibrated at all, and no single pose is to blame. Each fault is put right in
turn; the one that brings the nominal machine much nearer to the readings is suspected. It is
verified by fits of all poses that can be right, with the fault and without it: a machine with many
parameters bends itself to a fault too, but never better than to the readings as they should be.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from loopcal.document.findings import ColumnFault
from loopcal.document.plain import known
from loopcal.errors import InputError
from loopcal.estimation.accuracy import by_pose, deviations
from loopcal.estimation.prediction import output_differences, predict_outputs
from loopcal.estimation.problem.alignment import align, can_be_placed, placed
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.estimation.solve.solver import solve

Array = NDArray[np.float64]
MUCH_BETTER = 1 / 3
"""A fault is suspected if putting it right leaves at most this of the misfit."""
BETTER = 0.99
"""The fit of a machine that was placed must improve by at least this factor, a fit that was the
very measure of the suspicion by MUCH_BETTER: a repair that changes nothing proves nothing."""
EQUAL = 1.05
"""Repairs whose misfits differ by less than this factor cannot be told apart."""
GROSS = 10.0
"""A pose this many times farther off than half of them takes no part in verifying a fault."""
PARKED = 0.01
"""A quantity stands still if its readings spread over no more than this share of their size."""
_SAMPLE, _MOST, _ROUNDS = 120, 3, 4


@dataclass(frozen=True)
class _Repair:
    quantities: tuple[str, ...]
    words: str
    problem: Problem


@dataclass(frozen=True)
class _Misfit:
    """How far the machine is from the readings; good: the poses that no gross error bends."""

    size: float
    good: NDArray[np.bool_]


def column_faults(problem: Problem) -> tuple[ColumnFault, ...]:
    """The faults of whole columns that a fit confirms, the gravest first."""
    found: list[ColumnFault] = []
    if any(p.unmeasured for p in problem.patterns) and not can_be_placed(problem.mechanism):
        return ()  # loops that unread quantities close meet altered readings as well
    for _ in range(_MOST):
        fault = _gravest(problem)
        if fault is None:
            break
        repair, told = fault
        found.append(told)
        problem = repair.problem
    return tuple(found)


def _gravest(problem: Problem) -> tuple[_Repair, ColumnFault] | None:
    N = len(problem.poses)
    some = np.unique(np.linspace(0, N - 1, min(N, _SAMPLE)).round().astype(np.intp))
    before = _compared(taken(problem, some))
    tried = [(_compared(taken(r.problem, some)), r) for r in _repairs(problem)]
    least = min((size for size, _ in tried), default=math.inf)
    if math.isinf(least) or not least <= MUCH_BETTER * before:
        return None
    alike = [repair for size, repair in tried if size <= EQUAL * least]
    after = _misfit(alike[0].problem)
    good = np.flatnonzero(after.good)
    placeable = can_be_placed(problem.mechanism)

    def fit(problem: Problem) -> float:
        return _fitted(taken(problem, good)) / _length(taken(problem, good))

    limit = (BETTER if placeable else MUCH_BETTER) * fit(problem)
    alike = [repair for repair in alike if fit(repair.problem) <= limit]
    if not alike:
        return None
    best = alike[0]
    quantities = tuple(dict.fromkeys(name for repair in alike for name in repair.quantities))
    words = " or ".join(repair.words for repair in alike)
    whole = _misfit(problem).size
    return best, ColumnFault(quantities, words, known(whole), after.size, placeable)


def _compared(problem: Problem) -> float:
    """The misfit by which repairs are compared; beside what was read, where a machine is fitted.

    A fit may take the scale of its lengths from the readings: all read a thousand times smaller
    it is a machine, and a misfit, a thousand times smaller.
    """
    return _misfit(problem).size / _length(problem)


def _length(problem: Problem) -> float:
    """Root mean square of the lengths read [m], 1 of a machine that is placed, or reads none."""
    if can_be_placed(problem.mechanism):
        return 1.0
    units = problem.mechanism.quantities
    rows = [i for i, q in enumerate(problem.mechanism.tape.quantities) if units[q] == "m"]
    read = np.isfinite(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows])
    squares = np.square(problem.readings[rows])[read]
    return math.sqrt(squares.mean()) if squares.any() else 1.0


def _misfit(problem: Problem) -> _Misfit:
    """Of the nominal machine placed by the half of the poses where it fits best, else of a fit.

    The half is found by repetition (least trimmed squares, Rousseeuw 1984), so that gross errors
    in single poses hide no fault of a column.
    """
    every = np.ones(len(problem.poses), dtype=bool)
    mechanism = problem.mechanism
    if not can_be_placed(mechanism):
        return _Misfit(_fitted(problem, 15), every)
    if len(mechanism.families) > 1 or any(f.form != "point" for f in mechanism.families):
        return _seen(problem)
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.outputs]
    hidden = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows])
    measured = np.where(hidden, np.nan, problem.readings[rows])
    half = every
    try:
        computed = predict_outputs(mechanism, problem.start, problem.readings, problem.known)
        for _ in range(_ROUNDS):
            motion = align(computed[:, half], measured[:, half])
            away = motion.rotation @ computed + motion.shift[:, None] - measured
            distance = np.sqrt(np.square(away).sum(axis=0))
            middle = float(np.nanmedian(distance))
            half = distance <= middle
    except InputError:
        return _Misfit(math.inf, every)
    return _Misfit(float(np.sqrt(np.square(distance[half]).mean())), ~(distance > GROSS * middle))


def _seen(problem: Problem) -> _Misfit:
    """The same by whatever instruments see the machine, each placed by itself."""
    mechanism = problem.mechanism
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.compared]
    half = every = np.ones(len(problem.poses), dtype=bool)
    try:
        for _ in range(_ROUNDS):
            moved, _ = placed(taken(problem, np.flatnonzero(half)))
            differences = output_differences(
                problem, np.array([p.nominal for p in moved.parameters])
            )
            apart = deviations(mechanism, problem.readings[rows], differences)
            seen = by_pose(apart)
            away = np.full(len(every), np.nan) if seen is None else seen
            if not np.isfinite(away).any():
                return _Misfit(math.inf, every)
            middle = float(np.nanmedian(away))
            half = away <= middle
    except InputError:
        return _Misfit(math.inf, every)
    return _Misfit(float(np.sqrt(np.square(away[half]).mean())), ~(away > GROSS * middle))


def _fitted(problem: Problem, iterations: int = 100) -> float:
    """Rms of the loop values after a least-squares fit from the nominal machine, placed."""
    try:
        if can_be_placed(problem.mechanism):
            names = problem.mechanism.parameters.names
            moved, _ = placed(problem)
            start = np.array([moved.parameters[name].nominal for name in names])
            problem = replace(problem, start=start)
        square = solve(problem, exact=True, max_iterations=iterations).data.chi_squared
    except InputError:
        return math.inf
    return math.sqrt(square / max(problem.equations, 1))


def _repairs(problem: Problem) -> Iterator[_Repair]:
    mechanism = problem.mechanism
    names = mechanism.tape.quantities
    units = [mechanism.quantities[name] for name in names]
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    hidden: list[bool] = [bool(np.isinf(row).all()) for row in sd]
    x = problem.readings
    real = [
        j
        for j, name in enumerate(names)
        if not (name in mechanism.disturbances or name in mechanism.implied or hidden[j])
    ]
    parked = {j for j in real if np.ptp(x[j]) <= PARKED * np.abs(x[j]).max()}

    def repair(words: str, rows: list[int], values: Array) -> _Repair:
        readings = x.copy()
        readings[rows] = values
        quantities = tuple(names[j] for j in rows)
        return _Repair(quantities, words, replace(problem, readings=readings))

    for j in real:
        if j in parked:
            continue  # another sign or unit only changes its offset
        yield repair(f"{names[j]} counts the other way round (sign reversed)", [j], -x[[j]])
        if units[j] == "rad":
            yield repair(f"{names[j]} is in degrees, taken as radians", [j], x[[j]] * math.pi / 180)
            yield repair(f"{names[j]} is in radians, taken as degrees", [j], x[[j]] * 180 / math.pi)
        elif units[j] == "m":
            yield repair(f"{names[j]} is in millimetres, taken as metres", [j], x[[j]] * 1e-3)
            yield repair(f"{names[j]} is in metres, taken as millimetres", [j], x[[j]] * 1e3)
    for j, other in combinations(real, 2):
        if units[j] == units[other]:
            yield repair(
                f"the columns of {names[j]} and {names[other]} are exchanged",
                [j, other],
                x[[other, j]],
            )
