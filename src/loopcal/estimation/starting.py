"""Where the search for unmeasured angles begins: several places round the circle, the best kept.

A length that nobody reads is found from any start; an angle has several, and the loops may close
with one and be near closing with another. The reading's place holder, which for a gap lies
between its neighbours, keeps its right unless another start explains the pose far better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.sweep import Sweeper

Array = NDArray[np.float64]
_ROUND = 12
_MOST = 72
_FAR_BETTER = 0.25


def start_corrections(sweeper: Sweeper, parameters: Array) -> Array:
    """Corrections (k, N) [SI] to begin from, zero but for unmeasured quantities."""
    problem = sweeper.problem
    best = np.zeros_like(problem.readings)
    units = problem.mechanism.quantities
    names = problem.mechanism.tape.quantities
    for pattern, poses in problem.blocks():
        angles = [i for i in pattern.unmeasured if units[names[i]] == "rad"]
        if not angles:
            continue
        shape = best[:, poses].shape
        least = np.full(shape[1], np.inf)
        for offset in _offsets(len(angles)):
            start = np.zeros(shape)
            start[angles] = offset[:, None]
            closed, misfit = sweeper.close_block(parameters, start, pattern, poses)
            misfit = np.where(np.isfinite(misfit), misfit, np.inf)
            better = misfit < (_FAR_BETTER if np.any(offset) else 1.0) * least - 1e-9
            least = np.where(better, misfit, least)
            rows = list(pattern.unmeasured)
            kept = best[:, poses]
            kept[rows] = np.where(better, closed[rows], kept[rows])
            best[:, poses] = kept
    return best


def _offsets(angles: int) -> list[Array]:
    """Starts for some angles [rad], the first of them none at all; at most _MOST of them."""
    if angles == 1:
        return [np.array([2 * np.pi * i / _ROUND]) for i in range(_ROUND)]
    # Points of an additive recurrence (Roberts 2018) fill the torus evenly in any dimension.
    root = 1.5
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (angles + 1))
    steps = root ** -np.arange(1.0, angles + 1)
    return [2 * np.pi * ((i * steps) % 1.0) for i in range(_MOST)]
