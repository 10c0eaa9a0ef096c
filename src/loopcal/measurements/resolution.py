"""The grid that readings lie on: the step to which a sensor, or the file, rounds them.

Written decimals hide a coarser grid of counts: encoder counts of 12.17 urad, written to 1 urad,
lie 12, 24, 37 ... apart. Both are looked for, the coarser one within the rounding of the decimals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.measurements.dataset import Dataset
from loopcal.units import difference_to_si, from_si

_CHANCE = 1e-3
"""Numbers without a grid pass for one at most this often."""
_REPEATED = 1 / 3
"""So few different values among the readings, each far from the next, are a grid anyway."""
_REFINEMENTS = 4
"""The smallest step seen may be this many counts."""
# Powers of ten of the steps that are tried: doubles hold no more digits, files no coarser steps.
_FINEST, _COARSEST = 14, -3
_MOST = 60
"""Readings that are looked at; the step that they show holds for all."""


@dataclass(frozen=True)
class Grid:
    """decimals: step of the numbers as written; step: of the readings, never finer; both [unit].

    None where there is none.
    """

    decimals: float | None
    step: float | None


def grid(values: Array) -> Grid:
    """The grid of values (N,) in the unit in which they were written."""
    levels = np.unique(values)
    decimals = written_step(levels)
    if decimals is not None:  # one value, however it was rounded on the way
        levels = np.unique(np.round(levels / decimals)) * decimals
    coarse = None if decimals is None else _counts(levels, decimals, len(values))
    return Grid(decimals, decimals if coarse is None else coarse)


def written_step(values: Array) -> float | None:
    """The largest power of ten that all values are multiples of; None for real numbers or 0."""
    size = float(np.abs(values).max(initial=0.0))
    if size == 0.0:
        return None
    for digits in range(_COARSEST, _FINEST + 1):
        # Conversions of units leave errors of a few ulps, 1e-16 of the value, which scaling by
        # 10^digits keeps.
        if 10.0**-digits < 1e-11 * size:
            return None  # all digits of a double are used: nothing was rounded
        off = 1e-9 + 4e-16 * 10.0**digits * size
        # The first few say no soonest.
        if all(_whole(some * 10.0**digits, off) for some in (values[:100], values)):
            return float(10.0**-digits)
    return None


def _whole(values: Array, off: float) -> bool:
    """Whether all are whole numbers, but for so much."""
    return bool(np.all(np.abs(values - np.round(values)) <= off))


def _counts(levels: Array, decimals: float, number: int) -> float | None:
    """A step coarser than the decimals on which all levels lie within the decimals."""
    if len(levels) < 2:
        return None
    above = levels[1:] - levels[0]
    smallest = float(np.diff(levels).min())
    for parts in range(1, _REFINEMENTS + 1):
        step = _fitted(above, smallest / parts, decimals)
        # On a step of few decimals every level lies within their rounding.
        if step is None or step < 4.0 * decimals:
            continue
        # each level falls within the tolerance by chance this often
        chance = min(1.0, 3.0 * decimals / step) ** (len(above) - 1) * parts
        if chance < _CHANCE or len(levels) <= _REPEATED * number:
            return step
    return None


def _fitted(above: Array, step: float, decimals: float) -> float | None:
    """The step near this one of which all are multiples within the decimals, nearest first."""
    order = np.sort(above)
    for end in range(1, len(order) + 1):
        part = order[:end]
        counts = np.maximum(np.round(part / step), 1.0)
        # Least squares through zero; with more levels the step is known well enough to count
        # farther ones.
        step = float(part @ counts / (counts @ counts))
    counts = np.round(above / step)
    return step if np.all(np.abs(above - counts * step) <= 1.01 * decimals) else None


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
    # A grid of degrees is hidden once a program has multiplied by pi / 180.
    turned = unit == "rad" and stated in ("1", "rad")
    for written in (stated, "deg") if turned else (stated,):
        step = grid(np.asarray(from_si(some, written))).step
        if step is not None:
            return float(difference_to_si(step, written))
    return 0.0
