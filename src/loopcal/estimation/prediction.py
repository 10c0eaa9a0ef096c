"""What a mechanism predicts: its outputs from all other readings, by closing the loops."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.problem import Problem, Weighting, most_poses
from loopcal.estimation.sensitivity import pixel_loops
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage, engine_for
from loopcal.expressions.tape import Tape
from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.mechanism import Mechanism

_SETTLED = 1e-9
"""In units of UNMEASURED_SCALE: the next step of a found quantity is at most 1e-12 [m, rad]."""


def predict_outputs(
    mechanism: Mechanism,
    parameters: Array,
    readings: Array,
    pose_constants: Array,
    estimated: Sequence[str] = (),
) -> Array:
    """The outputs (o, N) [SI] that close the loops at these parameters; NaN where none do.

    parameters: (n_all,); readings: (k, N), with start values for the outputs;
    pose_constants: (c, N); estimated: parameters by which an engine of these loops has
    derivatives already.
    """
    rows = [mechanism.tape.quantities.index(name) for name in mechanism.outputs]
    predicting = mechanism.predicting()
    if (direct := pixel_loops(predicting, mechanism.outputs)) is not None:
        # A loop of pixels is computed minus read.
        values = _loop_values(
            predicting.tape, parameters, readings, pose_constants, tuple(estimated)
        )
        return readings[rows] + values[direct]
    loops = tuple(range(len(predicting.tape.loops)))
    place = {name: i for i, name in enumerate(predicting.parameters.names)}
    free = np.array([place[name] for name in estimated], dtype=np.intp)
    return _closed(predicting, loops, rows, parameters, readings, pose_constants, free)[rows]


def solving(mechanism: Mechanism, hidden: Collection[str]) -> Mechanism:
    """The mechanism whose outputs, found with what no sensor reads, come first of its outputs.

    Where the loops do not suffice to find both, what is hidden stays where it is.
    """
    machine = mechanism.predicting()
    aside = {*machine.disturbances, *machine.outputs, *machine.unused}
    also = [q for q in machine.tape.quantities if q in hidden and q not in aside]
    if len(also) + len(machine.outputs) > len(machine.tape.loops):
        return machine
    return replace(machine, outputs=(*machine.outputs, *also))


def _closed(
    mechanism: Mechanism,
    loops: tuple[int, ...],
    unknown: Sequence[int],
    parameters: Array,
    readings: Array,
    pose_constants: Array,
    free: NDArray[np.intp],
) -> Array:
    """All quantities (k, N) [SI], those at the positions `unknown` found; NaN where none close.

    They close the loops at the given positions with all other readings taken as exact. Where there
    are more loops than unknowns, they come nearest in least squares. A pose whose loops have no
    value at the start is lost. free: the parameters that a fit estimates, whose engine serves here.
    """
    names = tuple(mechanism.parameters.names[i] for i in free)
    start = _loop_values(mechanism.tape.only(loops), parameters, readings, pose_constants, names)
    begun = np.isfinite(start).all(axis=0)
    all_readings: Array = np.full(readings.shape, np.nan)
    if not begun.any():
        return all_readings
    if not begun.all():
        some = readings[:, begun], pose_constants[:, begun]
        all_readings[:, begun] = _closed(mechanism, loops, unknown, parameters, *some, free)
        return all_readings
    problem = Problem(
        mechanism,
        readings,
        pose_constants,
        ReadingUncertainty(np.zeros((len(readings), 1))),
        parameters,
        free,
        parameters[free],
        np.full(len(free), np.inf),
        ("",) * readings.shape[1],
        (Pattern(loops, tuple(unknown), (), slice(None)),),
        weighting=Weighting.ALIKE,
    )
    sweeper = Sweeper(problem)
    closed = sweeper.close(parameters, np.zeros(readings.shape), _SETTLED, 1.0)
    np.add(readings, closed.corrections, out=all_readings, where=~closed.open)
    return all_readings


def output_differences(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Array:
    """Computed minus measured (c, N) [SI], rows `mechanism.compared`; NaN: nothing to compare.

    Computed from the other readings as they are; unmeasured quantities come from the loops,
    beginning at their corrections. Turns from measured to computed orientations are the values of
    their own loops there, and so are the gaps between bodies of a whole robot.
    """
    mechanism = problem.mechanism
    quantities, depends = mechanism.tape.quantities, mechanism.tape.depends_on("quantity")
    compared = [quantities.index(q) for q in mechanism.compared]
    outputs = compared[: len(mechanism.outputs)]
    differences = np.full((len(compared), len(problem.poses)), np.nan)
    predicting = set(mechanism.predicting_loops)
    apart = {*mechanism.turns, *mechanism.gaps}
    for pattern in problem.patterns:
        if pattern.predicted:
            _of_images(problem, pattern, parameters, corrections, differences)
            continue
        loops = tuple(i for i in pattern.loops if i in predicting)
        inputs = frozenset().union(*(depends[i] for i in loops))
        present = [row for row in outputs if row not in pattern.absent]
        measured = [row for row in present if row not in pattern.unmeasured]
        further = [i for i in pattern.unmeasured if quantities[i] in inputs]
        unknown = list(dict.fromkeys([*present, *further]))
        closing = [i for i in pattern.loops if mechanism.tape.loops[i] in apart]
        if not (measured or closing) or len(unknown) > len(loops):
            continue  # nothing to compare with, or the other readings do not say where they are
        x = problem.readings[:, pattern.poses]
        if corrections is not None and pattern.unmeasured:
            x = x.copy()
            x[list(pattern.unmeasured)] += corrections[list(pattern.unmeasured)][:, pattern.poses]
        constants = problem.pose_constants[:, pattern.poses]
        predicted = x
        if unknown:
            predicted = _closed(mechanism, loops, unknown, parameters, x, constants, problem.free)
        for row in measured:
            computed = predicted[row] - problem.readings[row, pattern.poses]
            differences[compared.index(row), pattern.poses] = computed
        if closing:
            values = _loop_values(
                mechanism.tape.only(tuple(closing)), parameters, predicted, constants, ()
            )
            for loop, value in zip(closing, values, strict=True):
                row = mechanism.compared.index(mechanism.tape.loops[loop])
                differences[row, pattern.poses] = value
    return differences


def _of_images(
    problem: Problem,
    pattern: Pattern,
    parameters: Array,
    corrections: Array | None,
    differences: Array,
) -> None:
    """Of images, into the rows (c, N) of what is compared: values of the loops, whose slope by
    their own readings is -1."""
    mechanism = problem.mechanism
    x = problem.readings[:, pattern.poses]
    if corrections is not None and pattern.unmeasured:
        x = x.copy()
        x[list(pattern.unmeasured)] += corrections[list(pattern.unmeasured)][:, pattern.poses]
    values = _loop_values(
        mechanism.tape.only(pattern.loops),
        parameters,
        x,
        problem.pose_constants[:, pattern.poses],
        tuple(mechanism.parameters.names[i] for i in problem.free),
    )
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    compared = {name: row for row, name in enumerate(mechanism.compared)}
    for reading, value in zip(pattern.predicted, values, strict=True):
        row = compared.get(mechanism.tape.quantities[reading])
        if row is not None:
            missing = np.isinf(sd[reading, pattern.poses])
            differences[row, pattern.poses] = np.where(missing, np.nan, value)


def _loop_values(
    tape: Tape, parameters: Array, readings: Array, pose_constants: Array, names: tuple[str, ...]
) -> Array:
    """f(x, p) (m, N) at readings (k, N), by the engine with derivatives by these parameters."""
    size = most_poses(tape, len(names))
    engine = engine_for(tape, names, min(size, max(readings.shape[1], 1)))
    out = np.empty((len(tape.loops), readings.shape[1]))
    for begin in range(0, readings.shape[1], size):
        part = slice(begin, begin + size)
        out[:, part] = engine.evaluate(
            parameters, readings[:, part], pose_constants[:, part], Stage.VALUES
        ).f
    return out
