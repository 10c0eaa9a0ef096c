"""The step [SI] in which a column of a data set was recorded."""

from __future__ import annotations

import numpy as np

from loopcal.measurements.dataset import Dataset
from loopcal.measurements.resolution import grid
from loopcal.units import difference_to_si, from_si

_MOST = 60
"""So many readings show a step, which then holds for all."""


def recorded_step(data: Dataset, name: str) -> float:
    """The step of a column in the unit in which it was written; 0 for real numbers.

    Targets of a machine that were written instead of readings may lie on a grid as well.
    """
    values = data.readings[name]
    values = values[np.isfinite(values)]
    stated = data.source.stated.get(name, "1")
    some = values[:: max(1, -(-len(values) // _MOST))]
    step = grid(np.asarray(from_si(some, stated))).step
    return 0.0 if step is None else float(difference_to_si(step, stated))
