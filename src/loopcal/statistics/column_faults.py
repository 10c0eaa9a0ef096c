"""Faults of whole columns: exchanged, in another unit, or counted the other way round.

Such a file cannot be calibrated at all, and no single pose is to blame. Each fault is put right in
turn; the one that brings the nominal machine much nearer to the readings is then verified by a
fit of all poses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.alignment import can_be_placed, placed
from loopcal.estimation.problem import Problem, taken
from loopcal.estimation.solver import solve
from loopcal.mechanisms.model_error import PREFIX

Array = NDArray[np.float64]
MUCH_BETTER = 1 / 3
"""A fault is suspected, and verified, if putting it right leaves at most this of the misfit."""
_SAMPLE, _MOST = 120, 3


@dataclass(frozen=True)
class ColumnFault:
    """A fault of whole columns.

    quantities: concerned; words: what it is; before, after: rms of the loop values [SI] of a fit
    of all poses as read, and with the fault put right.
    """

    quantities: tuple[str, ...]
    words: str
    before: float
    after: float

    def document(self) -> dict[str, Any]:
        """Its entry in result.json."""
        return {
            "quantities": list(self.quantities),
            "words": self.words,
            "before": self.before if math.isfinite(self.before) else None,
            "after": self.after,
        }

    def __str__(self) -> str:
        return (
            f"{self.words}: put right, the loops fit to rms {self.after:.3g} "
            f"instead of {self.before:.3g}"
        )


@dataclass(frozen=True)
class _Repair:
    quantities: tuple[str, ...]
    words: str
    problem: Problem


def column_faults(problem: Problem) -> tuple[ColumnFault, ...]:
    """The faults of whole columns that a fit of all poses confirms, the gravest first."""
    found: list[ColumnFault] = []
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
    limit = MUCH_BETTER * _misfit(taken(problem, some))
    best: _Repair | None = None
    for repair in _repairs(problem):
        misfit = _misfit(taken(repair.problem, some))
        if misfit < limit:
            best, limit = repair, misfit
    if best is None:
        return None
    before, after = _fitted(problem), _fitted(best.problem)
    if not after <= MUCH_BETTER * before:
        return None
    return best, ColumnFault(best.quantities, best.words, before, after)


def _misfit(problem: Problem) -> float:
    """Rms distance of the nominal machine, placed as well as can be; else of a short fit."""
    if not can_be_placed(problem.mechanism):
        return _fitted(problem, 15)
    try:
        return placed(problem)[1].rms
    except InputError:
        return math.inf


def _fitted(problem: Problem, iterations: int = 100) -> float:
    """Rms of the loop values after a least-squares fit from the nominal machine."""
    try:
        if can_be_placed(problem.mechanism):
            names = problem.mechanism.parameters.names
            moved, _ = placed(problem)
            start = np.array([moved.parameters[name].nominal for name in names])
            problem = replace(problem, start=start)
        square = solve(problem, exact=True, max_iterations=iterations).sweep.data.chi_squared
    except InputError:
        return math.inf
    return math.sqrt(square / max(problem.equations, 1))


def _repairs(problem: Problem) -> Iterator[_Repair]:
    mechanism = problem.mechanism
    names = mechanism.tape.quantities
    units = [mechanism.quantities[name] for name in names]
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    hidden: list[bool] = [bool(np.isinf(row).all()) for row in sd]
    real = [j for j, n in enumerate(names) if not n.startswith(PREFIX) and not hidden[j]]
    x = problem.readings

    def repair(words: str, rows: list[int], values: Array) -> _Repair:
        readings = x.copy()
        readings[rows] = values
        quantities = tuple(names[j] for j in rows)
        return _Repair(quantities, words, replace(problem, readings=readings))

    for j in real:
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
