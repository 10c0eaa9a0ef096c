"""What a mechanism predicts: its outputs from all other readings, by closing the loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.patterns import held_loops
from loopcal.estimation.problem.problem import BLOCK, Problem
from loopcal.estimation.solve.kernel import eliminate
from loopcal.expressions.engine import Stage, engine_for
from loopcal.expressions.tape import Tape
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
_MOST = 50


def predict_outputs(
    mechanism: Mechanism, parameters: Array, readings: Array, known: Array
) -> Array:
    """The outputs (o, N) [SI] that close the loops at these parameters; NaN where none do.

    parameters: (n_all,); readings: (k, N), with start values for the outputs; known: (c, N).
    """
    rows = [mechanism.tape.quantities.index(name) for name in mechanism.outputs]
    tape = mechanism.predicting().tape
    return found_from_loops(tape, rows, parameters, readings, known)[rows]


def found_from_loops(
    tape: Tape, unknown: Sequence[int], parameters: Array, readings: Array, known: Array
) -> Array:
    """All quantities (k, N) [SI], those at the positions `unknown` found; NaN where none close.

    Newton's method on f(x, p) = 0 from the readings (k, N), by least squares where there are more
    loops than unknowns.
    """
    unknown = list(unknown)
    out = np.array(readings, dtype=float)
    names = tuple(tape.quantities[i] for i in unknown)
    engine = engine_for(tape, (), min(BLOCK, max(readings.shape[1], 1)), names)
    engine.at(parameters)
    for begin in range(0, readings.shape[1], BLOCK):
        part = slice(begin, begin + BLOCK)
        x = out[:, part]
        before = np.inf
        for _ in range(_MOST):
            values = engine.evaluate(x, known[:, part])
            reflections = eliminate(values.by_quantity)
            step = reflections.solve(reflections.apply(values.f)[: len(unknown)])
            x[unknown] -= step
            size = float(np.abs(step[np.isfinite(step)]).max(initial=0.0))
            if size <= 1e-12 or (size <= 1e-6 and size >= 0.5 * before):
                break
            before = size
        # least-squares closings leave the rest of the loops open: only the step tells
        lost = ~(np.abs(step) <= 1e-6).all(axis=0)
        x[:, lost] = np.nan
    return out


def output_differences(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Array:
    """Computed minus measured (c, N) [SI], rows `mechanism.compared`; NaN: nothing to compare.

    Computed from the other readings as they are; unmeasured quantities come from the loops,
    beginning at their corrections. Turns from measured to computed orientations are the values of
    their own loops there.
    """
    mechanism = problem.mechanism
    quantities = mechanism.tape.quantities
    compared = [quantities.index(q) for q in mechanism.compared]
    outputs = compared[: len(mechanism.outputs)]
    differences = np.full((len(compared), len(problem.poses)), np.nan)
    predicting = set(mechanism.predicting().tape.loops)
    for pattern in problem.patterns:
        loops = tuple(i for i in pattern.loops if mechanism.tape.loops[i] in predicting)
        tape = held_loops(mechanism.tape, loops)
        inputs = frozenset().union(*tape.depends_on()) if loops else frozenset()
        there = [row for row in outputs if row not in pattern.absent]
        measured = [row for row in there if row not in pattern.unmeasured]
        found_too = [i for i in pattern.unmeasured if quantities[i] in inputs]
        unknown = list(dict.fromkeys([*there, *found_too]))
        if not measured or len(unknown) > len(loops):
            continue  # nothing to compare with, or the other readings do not say where they are
        x = problem.readings[:, pattern.poses]
        if corrections is not None and pattern.unmeasured:
            x = x.copy()
            x[list(pattern.unmeasured)] += corrections[list(pattern.unmeasured)][:, pattern.poses]
        known = problem.known[:, pattern.poses]
        found = found_from_loops(tape, unknown, parameters, x, known)
        for row in measured:
            computed = found[row] - problem.readings[row, pattern.poses]
            differences[compared.index(row), pattern.poses] = computed
        turns = [i for i in pattern.loops if mechanism.tape.loops[i] in mechanism.turns]
        if turns:
            values = _loop_values(
                held_loops(mechanism.tape, tuple(turns)), parameters, found, known
            )
            for loop, value in zip(turns, values, strict=True):
                row = mechanism.compared.index(mechanism.tape.loops[loop])
                differences[row, pattern.poses] = value
    return differences


def _loop_values(tape: Tape, parameters: Array, readings: Array, known: Array) -> Array:
    """f(x, p) (m, N) at readings (k, N)."""
    engine = engine_for(tape, (), min(BLOCK, max(readings.shape[1], 1)), ())
    engine.at(parameters)
    out = np.empty((len(tape.loops), readings.shape[1]))
    for begin in range(0, readings.shape[1], BLOCK):
        part = slice(begin, begin + BLOCK)
        out[:, part] = engine.evaluate(readings[:, part], known[:, part], Stage.VALUES).f
    return out
