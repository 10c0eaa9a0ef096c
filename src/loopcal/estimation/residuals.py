"""The values of the loop equations, with and without corrections."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from loopcal.arrays import Array
from loopcal.document.fit import ClosureSize
from loopcal.document.plain import finite
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage


def residuals(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Mapping[str, Array]:
    """Loop values with these corrections, loop -> (N,), NaN where a loop does not hold.

    Unmeasured quantities stay where the fit left them.
    """
    loops = problem.mechanism.tape.loops
    out = np.full((len(loops), len(problem.poses)), np.nan)
    sweeper = Sweeper(problem)
    for pattern, block in sweeper.blocks(parameters, corrections):
        values = sweeper.loop_values(pattern, block, Stage.VALUES)
        for row, loop in enumerate(pattern.loops):
            out[loop, block.poses] = values.f[row]
        if pattern.predicted:
            sd = np.broadcast_to(block.noise.sd, block.readings.shape)[list(pattern.predicted)]
            for row, loop in enumerate(pattern.loops):
                out[loop, block.poses] = np.where(np.isinf(sd[row]), np.nan, values.f[row])
    return by_name(loops, out)


@dataclass(frozen=True)
class Closure:
    """Size of the loop equations' values [SI] over all poses; NaN where no loop has one."""

    rms: float
    max: float

    @classmethod
    def of(cls, residuals: Mapping[str, Array]) -> Closure:
        """From the values of the loops that hold, loop -> (N,)."""
        values = np.array(list(residuals.values()))
        values = values[np.isfinite(values)]
        if not values.size:
            return cls(math.nan, math.nan)
        return cls(float(np.sqrt(np.square(values).mean())), float(np.abs(values).max()))

    @property
    def entry(self) -> ClosureSize:
        """As a document holds it."""
        return ClosureSize(finite(self.rms), finite(self.max))


def by_name(names: tuple[str, ...], rows: Array) -> Mapping[str, Array]:
    """A read-only mapping from each name to its row, itself read-only."""
    arrays = dict(zip(names, rows, strict=True))
    for array in arrays.values():
        array.setflags(write=False)
    return MappingProxyType(arrays)
