"""Closing the loops of a block by Gauss-Newton, each pose by itself.

A step is halved where the linearisation did not hold. The compiled engine does the same
(engine/closing.hpp).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loopcal.estimation.solve.block import Block
from loopcal.estimation.solve.reduced import Closed, Reduced

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
