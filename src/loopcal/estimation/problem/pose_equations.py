"""The equations of every pose at a solution, whitened, with what each reading does to them.

    E = D dp + v,   v ~ N(0, 1),   and a reading that is wrong by d moves E by -X d,

after elimination of unmeasured quantities: D = T J_p, X = T J_x, T the whitening of the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper

Array = NDArray[np.float64]
_ROUNDING = 4.0 * np.finfo(np.float64).eps
"""Of each reading, as a share: so much of what an equation leaves is arithmetic."""


@dataclass(frozen=True)
class PoseEquations:
    """b poses with r equations each, n parameters and k quantities.

    poses: (b,) positions; E: (b, r); D: (b, r, n) [1/SI]; X: (b, r, k) [1/SI].
    """

    poses: NDArray[np.intp]
    E: Array
    D: Array
    X: Array


def pose_equations(
    problem: Problem,
    parameters: Array,
    corrections: Array,
    *,
    exact: bool = False,
    at_readings: bool = False,
) -> tuple[PoseEquations, ...]:
    """The equations at parameters (n_all,) and corrections (k, N) that close the loops there.

    exact: not whitened, the basic method's loop values; at_readings: take D where the readings
    stand, as the reweighted fit does.
    """
    sweeper = Sweeper(problem, exact=exact)
    sweeper.at(parameters)
    everything = np.arange(len(problem.poses))
    found = []
    for pattern, block in sweeper.blocks(corrections):
        engine, known = sweeper.engine(pattern), block.known
        J_p = engine.evaluate(block.read, known).by_parameter.copy() if at_readings else None
        values = engine.evaluate(block.corrected, known)
        identity = np.repeat(np.eye(len(pattern.loops))[:, :, None], block.count, axis=2)
        whitened = sweeper.reduce(replace(values, by_parameter=identity), block)
        T = whitened.D
        found.append(
            PoseEquations(
                everything[block.poses],
                whitened.E.T.copy(),
                np.einsum("crb,ncb->brn", T, values.by_parameter if J_p is None else J_p),
                np.einsum("crb,kcb->brk", T, values.by_quantity),
            )
        )
    return tuple(found)


def rounding_left(problem: Problem, equations: Sequence[PoseEquations]) -> float:
    """Mean square that rounding of the readings leaves in an equation: what is smaller says nothing
    of sensors or poses."""
    total, count = 0.0, 0
    readings = np.nan_to_num(np.abs(problem.readings))
    for block in equations:
        left = _ROUNDING * np.einsum("brk,kb->br", np.abs(block.X), readings[:, block.poses])
        total, count = total + float(np.square(left).sum()), count + left.size
    return total / max(count, 1)
