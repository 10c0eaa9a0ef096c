"""Conditions beyond those of a calibration, and readings with a coarser step, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import rounding_sd
from loopcal.measurements.resolution import written_step
from loopcal.presentation.shown import enumerated, with_unit
from loopcal.statistics.calibrated import Calibrated
from loopcal.units import difference_to_si, from_si

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


def rounded(calibrated: Calibrated, data: Dataset) -> str:
    """Which readings are rounded more coarsely than those of the calibration, and than their noise;
    empty where none are."""
    coarse: dict[tuple[str, float], list[str]] = {}
    if (earlier := calibrated.poses) is None:
        return ""
    for entry in calibrated.noise:
        for q in (q for q in entry.quantities if q in data.readings and q in earlier.readings):
            (written, step), (_, before) = (_step(some, q, entry.unit) for some in (data, earlier))
            if step > before and difference_to_si(rounding_sd(step), written) > entry.sd:
                coarse.setdefault((written, step), []).append(q)
    return " ".join(
        f"{enumerated(names)} {'is' if len(names) == 1 else 'are'} rounded to {step:g} {written}, "
        f"more coarsely than in the calibration: by an sd of {rounding_sd(step):.2g} {written}."
        for (written, step), names in coarse.items()
    )


def _step(data: Dataset, name: str, unit: str) -> tuple[str, float]:
    """The unit in which readings [SI unit] were written, and the step to which they were rounded;
    0 for real numbers and for one value, which may be round by chance."""
    written = data.source.stated.get(name, unit)
    values = from_si(data.readings[name][np.isfinite(data.readings[name])], written)
    return written, (written_step(values) or 0.0) if values.size and np.ptp(values) else 0.0


def _state(value: float, unit: str) -> str:
    """A state, not a difference: temperatures are in degC."""
    if unit == "K":
        return f"{from_si(value, 'degC'):.3g} degC"
    return with_unit(value, unit)
