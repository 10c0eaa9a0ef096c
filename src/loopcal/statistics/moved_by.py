"""How far a change along the run moves the end point: its size beside its significance.

In long runs a change of a tenth of the noise is significant. Whether it matters is another
question: by how much it moves what the machine is calibrated for.
"""

from __future__ import annotations

import math
from dataclasses import replace

from loopcal.document.change_points import ChangePoint
from loopcal.estimation.accuracy import accuracy
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.result import Result


def sized(result: Result, point: ChangePoint) -> ChangePoint:
    """The change with `moves`, the rms distance over the poses by which the whole of it moves the
    outputs, computed or read; unknown without outputs, and of a stream.

    Less what noise alone adds to its square: a change of r parameters by chance has a gain of r.
    """
    names = result.mechanism.compared
    if not names or result.all_poses is not None:
        return point
    problem, at = result.problem, result.solution
    values, readings = at.parameters.copy(), problem.readings.copy()
    parameters, read = result.mechanism.parameters.names, result.mechanism.tape.quantities
    for name, change in point.changes.items():
        if name in parameters:
            values[parameters.index(name)] += change.size
        elif name in read:
            readings[read.index(name)] += change.size
    moved = output_differences(replace(problem, readings=readings), values, at.corrections)
    before = result.differences_after
    off = {q: row - before[q] for q, row in zip(names, moved, strict=True)}
    displacement = accuracy(result.deviations(off))
    if displacement is None:
        return point
    real = max(1.0 - len(point.changes) / point.gain, 0.0) if point.gain else 0.0
    return replace(point, moves=displacement.rms * math.sqrt(real), unit=displacement.unit)
