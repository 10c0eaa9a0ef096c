"""The search for the variances of greatest restricted likelihood: one for sensors and for terms.

Fisher's scoring, with steps that are halved until the likelihood rises. No variance falls below its
bound: each step is the best one that keeps it so, hence a ratio reaches zero, or leaves it, when
the likelihood says so (Karush, Kuhn and Tucker), whatever the sds stated.

The information costs most. That of one place serves for the next steps, with the exact score of
each, until a step does not keep what it promised. Meanwhile the change of the score along each step
corrects it (Broyden, Fletcher, Goldfarb and Shanno 1970): where a component that the data demand is
left out, the information expected is far from the curvature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import MixedFit

Place = TypeVar("Place", bound=MixedFit)
# Caps against an endless search: 30 halvings leave 1e-9 of a step. Chosen, not derived.
_MOST, _HALVINGS = 200, 30
SETTLED = 1e-10
"""A step is the last one if it promises the criterion less than this, or than its rounding."""
_ROUNDING = 1e-14
"""Of the criterion's size, so much is rounding."""
# docs/decisions/0020.
_KEPT = 0.5
"""Where a step brings less than this of what it promised, or more than its inverse, the information
matrix it came from does not serve any more."""
# Above rounding, 1e-16, and far below any information that counts: chosen, not derived.
_RIDGE = 1e-12
"""Of a component's own information, so that what only shows in a sum takes a step too."""


Likelihood = Callable[[Array, Array | None], Place | None]
"""The restricted likelihood at variances x, None where the loops have no noise; the second
argument is an information that will do, None where it is wanted anew."""


@dataclass(frozen=True)
class Bounds:
    """What the search may do with each variance (c,).

    lowest: what it does not fall below; free: whether it moves at all; longest: by how much any
    may change in one step.
    """

    lowest: Array
    free: NDArray[np.bool_]
    longest: float = np.inf


@dataclass(frozen=True)
class Searched(Generic[Place]):
    """Where a search ended; step: the next one, which is not made; promised: what it would gain."""

    at: Place
    step: Array
    promised: float
    converged: bool


def search(
    likelihood: Likelihood[Place],
    at: Place,
    bounds: Bounds,
    *,
    enough: float = SETTLED,
    correcting: bool = True,
) -> Searched[Place]:
    """The greatest likelihood over what is free; it ends where a step promises no more than enough.

    correcting: the information by what each step shows. Then that of the end may be from farther
    away, and serves for steps alone.

    -2 log of the likelihood falls with every step.
    """
    serves, curvature = at.fresh, at.information
    for _ in range(_MOST):
        if not serves:
            at = likelihood(at.x, None) or at
        curvature = at.information if at.fresh else curvature
        step = scoring_step(replace(at, information=curvature), bounds)
        promised = max(float(step @ (2.0 * at.score - curvature @ step)), 0.0)
        if promised <= enough + _ROUNDING * abs(at.criterion):
            break
        lower = _lower(likelihood, at, step, bounds)
        if lower is None and at.fresh:
            break
        serves = False
        if lower is not None:
            share = (at.criterion - lower.criterion) / promised
            if correcting:
                curvature = _corrected(curvature, lower.x - at.x, at.score - lower.score)
            at, serves = lower, lower.fresh or _KEPT < share < 1.0 / _KEPT
    else:
        return Searched(at, step, promised, False)
    return Searched(at, step, promised, True)


def _corrected(curvature: Array, step: Array, change: Array) -> Array:
    """The curvature (c, c) that along a step d changes the score as it has, where that is down."""
    foreseen = curvature @ step
    along, seen = float(step @ foreseen), float(step @ change)
    if not (along > 0.0 and seen > 0.0):
        return curvature
    return np.asarray(
        curvature - np.outer(foreseen, foreseen) / along + np.outer(change, change) / seen
    )


def scoring_step(at: MixedFit, bounds: Bounds) -> Array:
    """Fisher's step d, the greatest of score d - d I d / 2 where no x falls below the lowest.

    With I = A^T A and u = x + d - lowest it is the least |A u - b| over u >= 0. Where I is that of
    the curvature and leads down, the step leads up as steeply.
    """
    step = np.zeros_like(at.x)
    diagonal = np.abs(np.diag(at.information))
    index = np.flatnonzero(bounds.free & (diagonal > 0.0))
    if not index.size:
        return step
    scale = 1.0 / np.sqrt(diagonal[index])
    information = at.information[np.ix_(index, index)] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(np.abs(values), _RIDGE))
    along = (vectors.T @ (at.score[index] * scale)) / root
    above = (at.x - bounds.lowest)[index] / scale
    best = vectors @ (along / root)
    if (best < -above).any():
        # A^T b = score + information above: the slope, at u = 0, of what the step makes greatest.
        A = root[:, None] * vectors.T
        best = _least_above_zero(A, A @ above + along) - above
    # u - above may round to just below -above, which would leave a ratio below its bound.
    step[index] = np.maximum(best, -above) * scale
    return step


def _least_above_zero(A: Array, b: Array) -> Array:
    """The u >= 0 of least |A u - b|; A: of full rank.

    What is zero and would gain most is freed, until nothing would gain; what then falls below zero
    is held there. Source: Lawson and Hanson (1974), chapter 23. SciPy has it, but loads for longer
    than a fit takes, in every process that learns sds.
    """
    u, free = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=bool)
    least = _RIDGE * np.linalg.norm(A, axis=0) * np.linalg.norm(b)
    for _ in range(3 * len(u)):
        gain = np.where(free, -np.inf, A.T @ (b - A @ u) - least)
        first = int(gain.argmax())
        if gain[first] <= 0.0:
            break
        free[first] = True
        while True:
            best = np.zeros(len(u))
            best[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
            below = free & (best <= 0.0)
            if not below.any():
                break
            shares = u[below] / np.maximum(u[below] - best[below], 1e-300)
            u = u + shares.min() * (best - u)
            free[np.flatnonzero(below)[shares.argmin()]] = False
            free &= u > 0.0
        u = best
    return u


def _lower(likelihood: Likelihood[Place], at: Place, step: Array, bounds: Bounds) -> Place | None:
    """After the longest of the halved steps that lowers the criterion; None if none does."""
    largest = float(np.abs(step).max(initial=0.0))
    if largest == 0.0:
        return None
    length = min(1.0, bounds.longest / largest)
    for _ in range(_HALVINGS):
        trial = likelihood(np.maximum(at.x + length * step, bounds.lowest), at.information)
        if trial is not None and trial.criterion < at.criterion:
            return trial
        length /= 2
    return None
