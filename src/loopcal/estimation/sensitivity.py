"""How the predicted outputs move with parameters and readings: the loops, solved for the outputs.

From f(x, p) = 0, with y the outputs and whatever else no sensor reads,

    dy = -J_y^+ (J_p dp + J_x dx).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import BLOCK
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


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
    poses, o = x.shape[1], len(outputs)
    by_parameter = np.full((poses, o, len(names)), np.nan)
    by_reading = np.full((poses, o, len(quantities)), np.nan)
    engine = engine_for(mechanism.tape, tuple(names), min(BLOCK, max(poses, 1)))
    for begin in range(0, poses, BLOCK):
        part = slice(begin, min(begin + BLOCK, poses))
        values = engine.evaluate(parameters, x[:, part], pose_constants[:, part])
        J_x = values.by_quantity.transpose(2, 1, 0)
        J_p = values.by_parameter.transpose(2, 1, 0)
        good = np.isfinite(J_x).all(axis=(1, 2)) & np.isfinite(J_p).all(axis=(1, 2))
        # There may be more loops than unknowns, which then come nearest in least squares. The
        # outputs are the first o of them.
        solve = -np.linalg.pinv(J_x[good][:, :, determined])[:, :o]
        where = np.flatnonzero(good) + begin
        by_parameter[where] = solve @ J_p[good]
        J_r = J_x[good].copy()
        J_r[:, :, determined] = 0.0
        by_reading[where] = solve @ J_r
    return Sensitivity(by_parameter, by_reading)
