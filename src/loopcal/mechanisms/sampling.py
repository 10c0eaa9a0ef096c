"""Poses in which a mechanism is looked at before there are any readings: random ones.

Loops that predict a reading are looked at where the joints stand by chance. What touches by
construction, a ball in its socket, does so in few poses: from random ones the joints are moved,
by Newton's method, to where the gap is closed, the thing touched being placed within reach first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.mechanism import Family, Mechanism

Array = NDArray[np.float64]
# [m, rad] off values that say little: large beside rounding, small beside any machine.
_OFF = 0.1
# Half a turn to either side covers every angle; half a metre is the stroke of a usual slide.
_SPAN = {"m": 0.5, "rad": math.pi}
# A gap [m] that counts as closed, Newton steps to it, and the longest of them [m, rad].
_CLOSED, _STEPS, _NEAR = 1e-9, 30, 0.3


@dataclass(frozen=True)
class Sample:
    """Some loops (their positions) at parameters (n,), readings (k, N) and constants (c, N)."""

    loops: Sequence[int]
    parameters: Array
    readings: Array
    pose_constants: Array


def samples(
    mechanism: Mechanism,
    *,
    ranges: Mapping[str, tuple[float, float]],
    unsure: Sequence[str],
    readings: Mapping[str, Array],
    seed: int,
) -> list[Sample]:
    """What to look at: the loops that hold in any pose, and those of each thing that is touched.

    ranges, unsure, readings: see `redundancy.redundant`.
    """
    draw = np.random.default_rng(seed)
    tape = mechanism.tape
    # Three times as many equations as parameters: rank is then that of generic poses.
    count = max(60, 3 * len(mechanism.parameters) // len(tape.loops))
    count = len(next(iter(readings.values()))) if readings else count
    values = dict(readings)
    for variable in mechanism.variables:
        if variable.name not in values:
            span = _SPAN.get(variable.unit, 1.0)
            limits = ranges.get(variable.first or variable.name, (-span, span))
            values[variable.name] = draw.uniform(*limits, count)
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    nominal |= {name: nominal[name] + _OFF * draw.uniform(0.5, 1.0) for name in unsure}
    p = np.array([nominal[name] for name in tape.parameters])
    x = np.array([values[q] for q in tape.quantities])
    pose_constants = _measured(
        mechanism, p, x, {name: values[name] for name in tape.pose_constants}
    )
    touched = [f for f in mechanism.families if f.form == "gap"]
    apart = {loop for family in touched for loop in family.loops}
    free = [i for i, loop in enumerate(tape.loops) if loop not in apart]
    sampled = [Sample(free, p, x, pose_constants)] if free else []
    return [
        *sampled,
        *(_touching(mechanism, f, Sample([], p, x, pose_constants), unsure) for f in touched),
    ]


def _measured(mechanism: Mechanism, p: Array, x: Array, pose_constants: dict[str, Array]) -> Array:
    """The known constants, orientations as they would be measured: not half a turn away."""
    tape, size = mechanism.tape, x.shape[1]
    engine = engine_for(tape, (), size, ())
    for orientation in mechanism.orientations:
        turns = [tape.loops.index(turn) for turn in orientation.turns]
        read = x[[tape.quantities.index(turn) for turn in orientation.turns]]
        q = np.vstack([np.ones(size), np.zeros((3, size))])
        pose_constants |= orientation.written(q)
        values = engine.evaluate(p, x, np.array([*pose_constants.values()]), Stage.VALUES)
        q[1:] = 0.5 * (values.f[turns] + read)
        pose_constants |= orientation.written(q)
    return np.array([*pose_constants.values()]).reshape(-1, size)


def _touching(
    mechanism: Mechanism, family: Family, anywhere: Sample, unsure: Sequence[str]
) -> Sample:
    """Poses in which what touches does; poses as they are where none can be found."""
    tape, size = mechanism.tape, anywhere.readings.shape[1]
    loops = [tape.loops.index(loop) for loop in family.loops]
    involved = {name for i in loops for name in tape.depends_on()[i]}
    placed = [n for n in unsure if n in involved]
    joints = [q for q in mechanism.quantities if q in involved and q not in family.readings]
    engine = engine_for(tape, tuple(placed), size, tuple(joints))
    p, x = anywhere.parameters.copy(), anywhere.readings.copy()
    rows = [tape.quantities.index(q) for q in joints]
    x[[tape.quantities.index(q) for q in family.readings]] = 0.0

    if placed:  # the first pose touches
        where = [tape.parameters.index(name) for name in placed]
        for _ in range(_STEPS):
            values = engine.evaluate(p, x, anywhere.pose_constants)
            A = values.by_parameter[:, loops, 0].T
            p[where] -= np.linalg.pinv(A) @ values.f[loops, 0]
    spread = x[rows] - x[rows][:, :1]
    # Other poses begin near the first one, where a closed gap is within reach.
    x[rows] = x[rows][:, :1] + _NEAR * spread
    for _ in range(_STEPS):
        values = engine.evaluate(p, x, anywhere.pose_constants)
        U = np.moveaxis(values.by_quantity[:, loops], 2, 0).transpose(0, 2, 1)
        step = np.linalg.pinv(U) @ values.f[loops].T[:, :, None]
        x[rows] -= np.clip(step[:, :, 0].T, -_NEAR, _NEAR)
    values = engine.evaluate(p, x, anywhere.pose_constants)
    closed = np.abs(values.f[loops]).max(axis=0) < _CLOSED
    if closed.mean() < 0.5:
        return Sample(loops, anywhere.parameters, anywhere.readings, anywhere.pose_constants)
    return Sample(loops, p, x[:, closed], anywhere.pose_constants[:, closed])
