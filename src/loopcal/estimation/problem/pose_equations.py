"""The equations of every pose at a solution, whitened, with what each reading does to them.

    E = D dp + v,   v ~ N(0, 1),   and a reading that is wrong by d moves E by -X d,

after elimination of unmeasured quantities: D = T J_p, X = T J_x, T the whitening of the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.solve.sweep import Sweeper

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

    @property
    def count(self) -> NDArray[np.intp]:
        """(b,) equations that say anything: corners that were not detected leave zeros."""
        counts: NDArray[np.intp] = self.X.any(axis=2).sum(axis=1)
        return counts


def pose_equations(
    problem: Problem, parameters: Array, corrections: Array
) -> tuple[PoseEquations, ...]:
    """The equations at parameters (n_all,) and corrections (k, N) that close the loops there.

    Whitened as the problem weighs them: loop values as they are where all count alike, D where the
    readings stand for the reweighted fit.
    """
    sweeper, as_read = Sweeper(problem), problem.weighting is Weighting.READ
    everything = np.arange(len(problem.poses))
    equations = []
    for pattern, block in sweeper.blocks(parameters, corrections):
        J_p = sweeper.loop_values(pattern, block.read).by_parameter.copy() if as_read else None
        values = sweeper.loop_values(pattern, block)
        # The kernel whitens what stands as derivatives: of the identity it makes T itself.
        identity = np.repeat(np.eye(len(pattern.loops))[:, :, None], block.count, axis=2)
        whitened = sweeper.reduce(replace(values, by_parameter=identity), block)
        T = whitened.D
        equations.append(
            PoseEquations(
                everything[block.poses],
                whitened.E.T.copy(),
                T.transpose(2, 1, 0)
                @ (values.by_parameter if J_p is None else J_p).transpose(2, 1, 0),
                _by_readings(T, values.by_quantity, pattern),
            )
        )
    return tuple(equations)


def _by_readings(T: Array, J: Array, pattern: Pattern) -> Array:
    """X = T J_x, (b, r, k); of images each pixel coordinate is in one loop alone."""
    if not pattern.predicted:
        return np.asarray(np.einsum("crb,kcb->brk", T, J))
    predicted = list(pattern.predicted)
    shared = [i for i in range(len(J)) if i not in set(predicted)]
    X = np.empty((T.shape[2], T.shape[1], len(J)))
    X[:, :, predicted] = (T * J[predicted, np.arange(len(predicted))][:, None, :]).transpose(
        2, 1, 0
    )
    X[:, :, shared] = T.transpose(2, 1, 0) @ J[shared].transpose(2, 1, 0)
    return X


def rounding_left(problem: Problem, equations: Sequence[PoseEquations]) -> float:
    """Mean square that rounding of the readings leaves in an equation: what is smaller says nothing
    of sensors or poses."""
    total, count = 0.0, 0
    readings = np.nan_to_num(np.abs(problem.readings))
    for block in equations:
        left = _ROUNDING * np.einsum("brk,kb->br", np.abs(block.X), readings[:, block.poses])
        total, count = total + float(np.square(left).sum()), count + left.size
    return total / max(count, 1)
