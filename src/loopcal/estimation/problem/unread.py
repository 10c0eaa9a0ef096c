"""Unmeasured quantities found in the loops of all poses of a pattern, block after block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import Pattern, Poses
from loopcal.estimation.solve.sweep import Sweeper

Array = NDArray[np.float64]
_SIZE = 1024


def found_in_loops(sweeper: Sweeper, start: Array, pattern: Pattern, poses: Poses) -> Array:
    """Corrections (k, b) [SI] with unmeasured quantities where they close the loops best.

    start: (k, b) corrections to begin from; the parameters are those of the sweeper.
    """
    problem, kernel = sweeper.problem, sweeper.kernel(pattern)
    readings, known = problem.readings[:, poses], problem.known[:, poses]
    noise, out = sweeper.noise(pattern, poses), start.copy()
    rows, size = list(pattern.unmeasured), min(_SIZE, problem.block)
    for begin in range(0, readings.shape[1], size):
        part = slice(begin, begin + size)
        given = readings[:, part], start[:, part], known[:, part], noise.of(part)
        out[rows, part] += kernel.search(*given)
    return out
