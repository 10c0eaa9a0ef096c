"""How the predicted outputs move with parameters and readings: the loops, solved for the outputs.

From f(x, p) = 0, with y the outputs and whatever else no sensor reads,

    dy = -J_y^+ (J_p dp + J_x dx).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.problem import most_poses
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import PIXELS, Mechanism


@dataclass(frozen=True)
class Sensitivity:
    """by_parameter: (N, o, n), by_reading: (N, o, k), zero for what is found; NaN where lost."""

    by_parameter: Array
    by_reading: Array


def output_sensitivity(
    mechanism: Mechanism,
    parameters: Array,
    names: Sequence[str],
    x: Array,
    pose_constants: Array,
    also: Sequence[int] = (),
) -> Sensitivity:
    """Derivatives of the outputs by the named parameters and by the readings.

    parameters: (n_all,); x: (k, N) where the loops close [SI]; pose_constants: (c, N); also:
    positions of further quantities that the loops determine.
    """
    mechanism = mechanism.predicting()
    quantities, unused = mechanism.tape.quantities, mechanism.unused
    outputs = [quantities.index(name) for name in mechanism.outputs]
    determined = [i for i in dict.fromkeys([*outputs, *also]) if quantities[i] not in unused]
    direct = None if len(determined) > len(outputs) else pixel_loops(mechanism, mechanism.outputs)
    poses, o = x.shape[1], len(outputs)
    by_parameter = np.full((poses, o, len(names)), np.nan)
    free = np.setdiff1d(np.arange(len(quantities)), determined)
    by_reading = np.zeros((poses, o, len(quantities)))
    by_reading[:, :, free], rows = np.nan, np.arange(o)
    size = most_poses(mechanism.tape, len(names))
    engine = engine_for(mechanism.tape, tuple(names), min(size, max(poses, 1)))
    for begin in range(0, poses, size):
        part = slice(begin, min(begin + size, poses))
        values = engine.evaluate(parameters, x[:, part], pose_constants[:, part])
        # Of the hundreds of pixels of an image each is in its own loop alone, with a slope of -1.
        of_quantities = values.by_quantity if direct is None else values.by_quantity[free]
        J_x = of_quantities.transpose(2, 1, 0)
        J_p = values.by_parameter.transpose(2, 1, 0)
        good = np.isfinite(J_x).all(axis=(1, 2)) & np.isfinite(J_p).all(axis=(1, 2))
        where = np.flatnonzero(good) + begin
        if direct is not None:
            by_parameter[where] = J_p[good][:, direct]
            by_reading[np.ix_(where, rows, free)] = J_x[good][:, direct]
            continue
        # There may be more loops than unknowns, which then come nearest in least squares. The
        # outputs are the first o of them.
        solve = -np.linalg.pinv(J_x[good][:, :, determined])[:, :o]
        by_parameter[where] = solve @ J_p[good]
        by_reading[np.ix_(where, rows, free)] = solve @ J_x[good][:, :, free]
    return Sensitivity(by_parameter, by_reading)


def pixel_loops(predicting: Mechanism, outputs: Sequence[str]) -> list[int] | None:
    """For each output the loop whose pixel it is; None where other loops are to be closed."""
    loop_of = {
        reading: loop
        for family in predicting.families
        if family.form == PIXELS
        for loop, reading in zip(family.loops, family.readings, strict=True)
    }
    loops = predicting.tape.loops
    if {loop_of.get(output) for output in outputs} != {*loops}:
        return None
    return [loops.index(loop_of[output]) for output in outputs]
