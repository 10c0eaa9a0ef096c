"""Temperatures, loads and other known columns beyond the range of a calibration, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.presentation.shown import with_unit
from loopcal.units import from_si

MEASURE = "Measure poses there and update."
"""What to do about it, but for an update."""
# Chosen, not derived: a linear law that was measured over a range is trusted somewhat beyond it.
_BEYOND = 0.25
"""Share of the range of a condition by which it may be left without a word."""


def unlike(
    conditions: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
    columns: Mapping[str, Array],
) -> list[str]:
    """A sentence for each known column (N,) [SI] that leaves the range of the calibration."""
    words = []
    for name, (low, high) in conditions.items():
        values, beyond = columns.get(name, np.zeros(0)), _BEYOND * (high - low)
        off = values[(values < low - beyond) | (values > high + beyond)]
        if off.size:
            far = float(off[np.argmax(np.maximum(low - off, off - high))])
            span = " to ".join(dict.fromkeys(_state(v, units[name]) for v in (low, high)))
            words.append(
                f"OTHER CONDITIONS  {name} reaches {_state(far, units[name])}; the calibration was "
                f"measured at {span}. What the machine does beyond is extrapolated."
            )
    return words


def _state(value: float, unit: str) -> str:
    """A state, not a difference: temperatures are in degC."""
    if unit == "K":
        return f"{from_si(value, 'degC'):.3g} degC"
    return with_unit(value, unit)
