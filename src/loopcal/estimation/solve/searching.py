"""Unmeasured quantities from the loops of each pose, the readings held as they are.

    minimise sum_j (f_j / s_j)^2 over the unmeasured quantities of a pose, s_j its sd,

by Levenberg's and Marquardt's method, every pose with a damping of its own. No more than a start:
readings are not corrected, and where loops disagree, what is found is a compromise of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.kernel import eliminate
from loopcal.expressions.engine import Engine, LoopValues, Stage

Array = NDArray[np.float64]
Evaluate = Callable[[Array, Array], LoopValues]
# Chosen, not derived: a cap; many starts are searched, so each has little time.
_MOST = 40
# Chosen, not derived: within it, closing the loops converges by itself.
_SETTLED = 1e-6
"""A step this small [m, rad] ends the search; closing the loops goes on from there."""
# Factors of ten as Marquardt (1963); damping of 1e8 leaves 1e-8 of a step.
_FIRST, _SOFTER, _HARDER, _STUCK = 1e-3, 0.1, 10.0, 1e8
"""Damping beside the squared length of a column: at first, after good and bad steps, given up."""


def search(engine: Engine, block: Block) -> Array:
    """What the unmeasured quantities (u, b) change by until they close the loops best.

    The engine gives derivatives by all quantities.
    """
    rows, x, constants = list(block.noise.unmeasured), block.corrected, block.pose_constants
    evaluate = partial(engine.evaluate, block.parameters, stage=Stage.BY_QUANTITY)
    weight = _weights(evaluate, x, constants, block.noise)
    first = x[rows]
    done, active = first.copy(), np.arange(x.shape[1])
    damping = np.full(x.shape[1], _FIRST)
    f, J = _weighted(evaluate, x, constants, rows, weight)
    cost = np.square(f).sum(axis=0)
    for _ in range(_MOST):
        step = _step(f, J, damping)
        trial = x.copy()
        trial[rows] += step
        f_new, J_new = _weighted(evaluate, trial, constants, rows, weight)
        cost_new = np.square(f_new).sum(axis=0)
        better = cost_new <= cost  # false where either is no number
        x, f = np.where(better, trial, x), np.where(better, f_new, f)
        J, cost = np.where(better, J_new, J), np.where(better, cost_new, cost)
        damping = np.where(better, _SOFTER * damping, _HARDER * damping)
        done[:, active] = x[rows]
        rest = ~((np.abs(step).max(axis=0) <= _SETTLED) | (damping > _STUCK))
        if not rest.any():
            break
        active, damping, cost = active[rest], damping[rest], cost[rest]
        x, constants, weight = x[:, rest], constants[:, rest], weight[:, rest]
        f, J = f[:, rest], J[:, :, rest]
    change: Array = done - first
    return change


def _weights(evaluate: Evaluate, x: Array, constants: Array, noise: BlockNoise) -> Array:
    """1 / the sd of each loop (m, b) that the sds of measured quantities give it; 1 if none."""
    sure = np.where(np.isinf(noise.sd), 0.0, noise.sd)
    slopes = evaluate(x, constants).by_quantity
    spread = np.sqrt(np.square(slopes * sure[:, None]).sum(axis=0))
    usable = np.isfinite(spread) & (spread > 0.0)
    return np.where(usable, 1.0 / np.where(usable, spread, 1.0), 1.0)


def _weighted(
    evaluate: Evaluate, x: Array, constants: Array, rows: list[int], weight: Array
) -> tuple[Array, Array]:
    """Loop values (m, b) and derivatives (u, m, b), in sds."""
    values = evaluate(x, constants)
    return values.f * weight, values.by_quantity[rows] * weight


def _step(f: Array, J: Array, damping: Array) -> Array:
    """The damped step (u, b) of least squares; none where derivatives are no numbers."""
    u = len(J)
    length = np.sqrt(np.square(J).sum(axis=1))
    # Damping by the length of each column, so that metres and radians need no common unit
    # (Marquardt 1963).
    below = np.eye(u)[:, :, None] * (np.sqrt(damping) * length)[:, None, :]
    reflections = eliminate(np.concatenate([J, below], axis=1))
    right = np.concatenate([f, np.zeros((u, f.shape[1]))])
    step = -reflections.solve(reflections.apply(right)[:u])
    return np.where(np.isfinite(step).all(axis=0), step, 0.0)
