"""Joints that stand still: what reads the same in every pose has no errors of its own in each.

Taken as uncertain, such a joint would seem to move by its corrections, which then tell parameters
apart that no pose does; where nothing is known of these, the fit follows them without end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.mechanism import Mechanism

# docs/decisions/0052.
FEWEST = 3
"""Poses from which equal readings are no chance."""


def standing(mechanism: Mechanism, readings: NDArray[np.float64]) -> list[int]:
    """Positions of the joints that read the same in every pose; readings (k, N).

    Not those of instruments, whose readings follow from the machine, nor what is no reading (an
    error of the machine model, taken as 0).
    """
    if readings.shape[1] < FEWEST:
        return []
    alike = np.flatnonzero((readings == readings[:, :1]).all(axis=1)).tolist()
    if not alike:
        return []
    seen = {q for family in mechanism.families for q in family.readings}
    seen |= {*mechanism.implied, *mechanism.disturbances}
    return [i for i in alike if mechanism.tape.quantities[i] not in seen]


def standing_exact(
    mechanism: Mechanism, readings: NDArray[np.float64], uncertainty: ReadingUncertainty
) -> ReadingUncertainty:
    """The uncertainty with the readings (k, N) of joints that never move taken as exact.

    What they are off by is the same in all poses, and parameters take it up. Not where a loop would
    be left without any reading that is uncertain.
    """
    alike = standing(mechanism, readings)
    if not alike:
        return uncertainty
    names, loops = mechanism.tape.quantities, mechanism.tape.depends_on()
    inside = {i for block in uncertainty.blocks for i in block.indices}
    sd = uncertainty.sd
    uncertain = [bool((row > 0.0).all()) for row in sd]
    still = [i for i in alike if i not in inside and uncertain[i] and np.isfinite(sd[i]).all()]
    moving = {name for i, name in enumerate(names) if uncertain[i] and i not in still}
    if not still or not all(moving.intersection(inputs) for inputs in loops):
        return uncertainty
    exact = sd.copy()
    exact[still] = 0.0
    return replace(uncertainty, sd=exact)
