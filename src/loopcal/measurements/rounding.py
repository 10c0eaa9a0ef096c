"""The step [SI] in which a column of a data set was recorded."""

from __future__ import annotations

import numpy as np

from loopcal.measurements.dataset import Dataset
from loopcal.measurements.resolution import grid
from loopcal.units import difference_to_si, from_si

_MOST = 60
"""So many readings show a step, which then holds for all."""


def recorded_step(data: Dataset, name: str, unit: str = "") -> float:
    """The step of a column in the unit in which it was written; 0 for real numbers.

    unit: of the quantity [SI]; angles that a program hands over in radians are looked at in
    degrees too. Targets of a machine that were written instead of readings may lie on a grid as
    well.
    """
    values = data.readings[name]
    values = values[np.isfinite(values)]
    stated = data.source.stated.get(name, "1")
    some = values[:: max(1, -(-len(values) // _MOST))]
    turned = unit == "rad" and stated in ("1", "rad")
    for written in (stated, "deg") if turned else (stated,):
        step = grid(np.asarray(from_si(some, written))).step
        if step is not None:
            return float(difference_to_si(step, written))
    return 0.0
