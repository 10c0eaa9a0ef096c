"""Closing the loops of a block by Gauss-Newton, each pose by itself.

A step is halved where the linearisation did not hold. The compiled engine does the same
(engine/closing.hpp).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.solve.block import Block
from loopcal.lazy import cached_property

# Chosen, not derived: iterations that still halve the step leave 1e-5 of it.
MOST_CLOSINGS = 16
"""Newton, who knows the curvature, takes over what is not closed after so many iterations."""
NEGLIGIBLE = 1e-6
"""A step of so many sds leaves a next one that only rounding sees."""
UNMEASURED_SCALE = 1e-3
"""What counts as one sd for the step of an unmeasured quantity: 1 mm or 1 mrad."""


def close_by_gauss_newton(
    corrected: Callable[[Block], Reduced], block: Block, tolerance: float, contraction: float
) -> Closed:
    """Corrections that leave at most `tolerance` sds to correct.

    corrected: reduces a block; contraction: of steps, as far as known. For a pose that stays open
    the corrections are those to go on from.
    """
    start, count = block.corrections, block.count
    done, late = start.copy(), np.zeros(count, dtype=bool)
    active, part = np.arange(count), block
    # the start is a step from the readings, halved where it leaves the domain of a loop
    at, base = start, np.zeros_like(start)
    step, length = start, np.ones(count)
    expected = np.full(count, np.inf)
    last = ratio = 0.0
    evaluations = 0
    for _ in range(MOST_CLOSINGS):
        reduced = corrected(part.at(at))
        correction, size = reduced.correction, reduced.step
        evaluations += part.count
        # A step larger than the one before, or one that is no number, overshot: halve it.
        allowed = np.maximum(2.0 * expected, max(tolerance, NEGLIGIBLE))
        overshot = ~(size <= allowed) & (length > 1e-3)
        first = np.isinf(expected)
        ratios = np.where(first, contraction, size / expected)
        ratio = max(ratio, float(np.fmax.reduce(ratios[~first], initial=0.0)))
        stuck = (expected <= NEGLIGIBLE) & (size > 0.25 * expected)  # by rounding
        # What is left to correct after this step is about size * ratio.
        finished = ~overshot & ((size * ratios <= tolerance) | stuck)
        last = max(last, float(size[finished].max(initial=0.0)))
        done[:, active[finished]] = correction[:, finished]
        rest = ~finished
        if not rest.any():
            return Closed(done, late, last, ratio, evaluations)
        base = np.where(overshot, base, at)[:, rest]
        step = np.where(overshot, step, correction - at)[:, rest]
        length = np.where(overshot, 0.5 * length, 1.0)[rest]
        expected = np.where(overshot, expected, size)[rest]
        active, part = active[rest], part.of(np.flatnonzero(rest))
        at = base + length * step
    late[active] = True
    done[:, active] = np.where(np.isfinite(base), base, start[:, active])
    return Closed(done, late, last, ratio, evaluations)


# What a block kernel gives: corrections, and the equations in the parameters.


@dataclass(frozen=True)
class Reduced:
    """A block of b poses, linearised at readings + corrections and reduced.

    correction: (k, b) new corrections with these parameters held [SI]; step: (b,) the longest
    move to them in sds; singular: (b,) poses whose loops cannot close; rows: (n + 1, r, b), the n
    columns of D and last E, or total: (n + 1, n + 1), their products summed over loops and poses.
    rows are overwritten by the next block.
    """

    correction: Array
    step: Array
    singular: NDArray[np.bool_]
    rows: Array | None = None
    total: Array | None = None

    @property
    def E(self) -> Array:
        """Whitened misclosure, (r, b)."""
        assert self.rows is not None
        part: Array = self.rows[-1]
        return part


@dataclass(frozen=True)
class Closed:
    """Corrections (k, b) [SI], and the poses (b,) that did not settle.

    step: the largest last step in sds; contraction: the worst ratio of a step to the one before,
    0 where there was none before; evaluations: of the loops, summed over poses.
    """

    corrections: Array
    open: NDArray[np.bool_]
    step: float = np.inf
    contraction: float = 0.0
    evaluations: int = 0

    @cached_property
    def failed(self) -> bool:
        """Whether any pose did not settle."""
        return bool(self.open.any())
