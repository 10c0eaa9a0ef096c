"""Rows that were copied: equal in every column, which no two measurements are.

A copy tells nothing new, yet would count as a pose of its own. Coarse readings of a pose that was
measured again may agree by chance. How often they do follows from the grid on which a column was
written and from the scatter of readings that were repeated: two normal readings of sd s fall on the
same step of a grid q with probability q / (2 sqrt(pi) s).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal import chi_squared
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.rounding import recorded_step

Array = NDArray[np.float64]
Positions = NDArray[np.intp]
CHANCE = 1e-6
"""Rows are copies if so many would agree by chance with at most this probability."""
_ROUGHLY = 2.0
"""How far off the number expected may be."""


def copies(data: Dataset, quantities: Sequence[str], outputs: Collection[str]) -> Positions:
    """Positions of the rows that copy an earlier one in all of these quantities.

    outputs: those that an instrument reads while the others say where the machine stands. None
    where they were sought already or rows were taken several times on purpose (`Source.judged`),
    or where measuring a pose again may well have read the same.
    """
    names = [q for q in quantities if q in data.readings]
    read = [q for q in names if q in outputs]
    none = np.zeros(0, dtype=np.intp)
    if data.source.judged or not names or len(data) < 2:
        return none
    if not read:  # nothing tells what was set from what was read, and so what may agree by chance
        return none
    told = np.isfinite([data.readings[q] for q in read]).any(axis=0)
    first, of = _alike(_numbers(data, names))
    again = np.flatnonzero((first[of] != np.arange(len(data))) & told)
    if not again.size:
        return none
    by_chance = _by_chance(data, [q for q in names if q not in outputs], read)
    return again if _rare(again.size, _ROUGHLY * by_chance) else none


def _numbers(data: Dataset, names: Sequence[str]) -> Array:
    """(k, N) readings, and the sds that came with them; one kind of zero and of NaN."""
    rows = [data.readings[q] for q in names] + [data.sds[q] for q in names if q in data.sds]
    found = np.array(rows).reshape(len(rows), len(data)) + 0.0
    found[np.isnan(found)] = np.nan
    return found


def _alike(rows: Array) -> tuple[Positions, Positions]:
    """The first of each kind of column of rows (k, N), and which kind every column is (N,)."""
    flat = np.ascontiguousarray(rows.T)
    keys = flat.view(np.dtype((np.void, flat.dtype.itemsize * flat.shape[1]))).ravel()
    _, first, of = np.unique(keys, return_index=True, return_inverse=True)
    return first, of.ravel()


def _by_chance(data: Dataset, driven: list[str], read: list[str]) -> float:
    """How many pairs would agree by chance, from the scatter of poses that were measured again."""
    if not driven:
        return 0.0
    _, pose = _alike(_numbers(data, driven))
    counts = np.bincount(pose)
    several = counts[pose] > 1
    share, scatters = 1.0, False
    for name in read:
        values = data.readings[name]
        good = several & np.isfinite(values)
        own, number = pose[good], np.bincount(pose[good], minlength=len(counts))
        mean = np.bincount(own, values[good], len(counts)) / np.maximum(number, 1)
        spare = int(np.maximum(number - 1, 0).sum())
        square = float(np.square(values[good] - mean[own]).sum())
        if spare and square > 1e-24 * np.square(values[good]).sum():
            scatters = True
            share *= min(
                1.0, recorded_step(data, name) / (2.0 * math.sqrt(math.pi * square / spare))
            )
    return share * float((counts * (counts - 1.0)).sum() / 2.0) if scatters else 0.0


def _rare(number: int, expected: float) -> bool:
    """Whether so many are improbable: P(Poisson >= n) = P(chi-squared of 2n < 2 expected)."""
    if expected <= 0.0:
        return True
    if expected >= number:
        return False
    return chi_squared.lower(2.0 * expected, 2 * number) <= CHANCE
