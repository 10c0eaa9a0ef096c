"""The values of the loop equations, with and without corrections."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loopcal.document.fit import ClosureSize
from loopcal.document.plain import known
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage

Array = NDArray[np.float64]


def residuals(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Mapping[str, Array]:
    """Loop values with these corrections, loop -> (N,), NaN where a loop does not hold.

    Unmeasured quantities stay where the fit left them.
    """
    loops = problem.mechanism.tape.loops
    out = np.full((len(loops), len(problem.poses)), np.nan)
    sweeper = Sweeper(problem)
    sweeper.at(parameters)
    none = np.broadcast_to(0.0, problem.readings.shape)
    for pattern, block in sweeper.blocks(none if corrections is None else corrections):
        found = sweeper.engine(pattern).evaluate(block.corrected, block.known, Stage.VALUES)
        for row, loop in enumerate(pattern.loops):
            out[loop, block.poses] = found.f[row]
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
        return ClosureSize(known(self.rms), known(self.max))


def by_name(names: tuple[str, ...], rows: Array) -> Mapping[str, Array]:
    """A read-only mapping from each name to its row, itself read-only."""
    found = dict(zip(names, rows, strict=True))
    for array in found.values():
        array.setflags(write=False)
    return MappingProxyType(found)
