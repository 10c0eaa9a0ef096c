"""Another optimum of the same readings: parameters exchanged that a very uncertain angle leaves so.

The likelihood of a loop has one optimum while the noise of the angles is small. Where an angle is
read to a few degrees only, or not at all, a linkage may stand in another form: two links exchanged
meet the same end points nearly as well. Such exchanges are tried, each by a fit of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import OtherOptimum
from loopcal.errors import InputError
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solver import solve
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.presentation.shown import significant, with_unit

# The arc leaves its tangent by 0.02^2 / 2 of the lever, 0.2 mm of a metre: chosen, not derived.
VAGUE = 0.02
"""From this sd of an angle on [rad] a loop is no longer straight within its noise."""
# Chosen, not derived: readings whose sds are guessed do not tell such optima apart.
ALIKE = 2.0
"""An optimum is told of if its chi-squared is at most this many times that of the result."""
# Chosen, not derived: far outside any interval.
APART = 10.0
"""Parameters fewer sds apart than this are the same, exchanged or not."""
# Chosen, not derived: links of one machine are mostly less unlike.
LIKE_SIZE = 1 / 3
"""Two parameters of more different size are no two links that could stand for each other."""
# Chosen, not derived: each pair costs a fit.
_MOST = 30
# Chosen, not derived: above what convergence leaves open, below what another optimum changes.
_SAME = 1e-6


def other_optima(result: FitResult) -> tuple[OtherOptimum, ...]:
    """Optima of the implicit loop with two parameters exchanged that fit about as well.

    Sought where an angle is read with an sd of at least VAGUE, or not at all; elsewhere, and for
    other methods and losses, none, and none of images, each of which shows where the whole body
    stands. A machine that states its home states with it the form in which it stands. An optimum
    with the same chi-squared is the same machine written otherwise, and is not told of. Nor is one
    that moves no parameter by 3 sds: a joint of some pose without a reading stands elsewhere.
    """
    usable = result.fit.solver.solve is solve and result.fit.robust_loss is None
    usable = usable and all(family.form != PIXELS for family in result.mechanism.families)
    if not (usable and result.status.converged and result.chi_squared and _vague(result)):
        return ()
    best = result.chi_squared.value
    optima: dict[float, OtherOptimum] = {}
    with one_blas_thread():
        for start in _exchanged(result):
            try:
                other = solve(replace(result.problem, start=start), max_iterations=60)
            except InputError:
                continue  # no loop closes with these two exchanged
            chi = other.chi_squared
            new = all(abs(chi - value) > _SAME * max(best, 1.0) for value in (best, *optima))
            if other.status.converged and new and chi <= ALIKE * best:
                optimum = _optimum(result, other.parameters, chi)
                if optimum.parameters:
                    optima[chi] = optimum
    return tuple(optima[chi] for chi in sorted(optima))


def _vague(result: FitResult) -> bool:
    """Whether an angle in some loop that holds is read so, or not at all."""
    problem, quantities = result.problem, result.mechanism.quantities
    home = {**result.mechanism.implied, **result.mechanism.home}
    angles = {
        i
        for i, name in enumerate(result.mechanism.tape.quantities)
        if quantities[name] == "rad" and name not in home
    }
    sds = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    return any(
        bool((sds[i, pattern.poses] >= VAGUE).any())
        for pattern in problem.patterns
        for i in angles.difference(pattern.absent)
    )


def _exchanged(result: FitResult) -> Iterator[Array]:
    """Parameters with two of one unit and like size exchanged, those farthest apart first."""
    names = result.mechanism.parameters.names
    values = np.array([result.value[name] for name in names])
    sds = {name: result.sd[name] or 0.0 for name in result.estimated}
    pairs = []
    for a, b in combinations(result.estimated, 2):
        alike = result.mechanism.parameters[a].unit == result.mechanism.parameters[b].unit
        apart = abs(result.value[a] - result.value[b])
        small, large = sorted((abs(result.value[a]), abs(result.value[b])))
        if alike and small > LIKE_SIZE * large and apart > APART * math.hypot(sds[a], sds[b]):
            pairs.append((apart, names.index(a), names.index(b)))
    for _, i, j in sorted(pairs, reverse=True)[:_MOST]:
        start = values.copy()
        start[[i, j]] = start[[j, i]]
        yield start


def _optimum(result: FitResult, parameters: Array, chi_squared: float) -> OtherOptimum:
    values = dict(zip(result.mechanism.parameters.names, parameters.tolist(), strict=True))
    moved = {
        name: values[name]
        for name in result.estimated
        if abs(values[name] - result.value[name]) > 3.0 * (result.sd[name] or 0.0)
    }
    assert result.chi_squared is not None
    best = result.chi_squared.value
    values_shown = ", ".join(
        f"{name} {with_unit(value, result.mechanism.parameters[name].unit, 4)}"
        for name, value in moved.items()
    )
    verdict = "it fits better: start there (fit.start), or state prior sds"
    if chi_squared >= best:
        # Sds larger by this root bring chi-squared down to that of the result.
        times = significant(math.sqrt(chi_squared / max(best, 1e-300)), 3)
        verdict = (
            f"it would fit as well with sds {times} times as large: check against the drawing, "
            f"or state a prior"
        )
    numbers = f"chi-squared {significant(chi_squared, 4)} beside {significant(best, 4)}"
    words = f"another optimum: {values_shown}, {numbers}; {verdict}"
    return OtherOptimum(moved, chi_squared, words, best)
