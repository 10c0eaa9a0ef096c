"""Rows that were copied: equal in every column, which no two measurements are.

A copy adds no information, yet would count as a pose. Coarse readings of a pose that was
measured again may agree by chance. How many do follows from the readings of one pose that differ.
Were the steps of an instrument that coarse, many of them would differ by one step alone: n_1 pairs
by one step and n_2 by two let n_0 = n_1^2 / (2 n_2) pairs agree, or fewer. The steps are counted in
the values themselves, whatever unit, scale or number of decimals they were written in:

- of several outputs, a pair differs by as many steps as outputs differ: they are rounded each for
  itself, so coarse readings often agree in all outputs but one. n_1^2 / (2 n_2) is exact for many
  outputs, and twice too many for two;
- of a single output, the least difference among poses with like values is one step. The pairs of a
  grid fall off as exp(-(step / 2 sd)^2 m^2), so n_0 = n_1 / 2 for fine steps, and less than stated
  for coarse ones. Unrounded readings give half a pair for every `_LIKE` that differ.

A value that other poses have taken too lies on a coarse step in any case.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal import chi_squared
from loopcal.arrays import Array
from loopcal.measurements.dataset import Dataset

Positions = NDArray[np.intp]
CHANCE = 1e-6
"""Rows are copies if their number would agree by chance with at most this probability."""
_LIKE = 20
"""Pairs of the poses whose values are nearest; their steps are taken to be alike."""
_OFTEN = 10
"""Readings of one pose agree at least so many times as often as those of different poses."""
_SAME = 1e-12
"""Relative difference of values that differ by arithmetic alone."""
_MOST = 40
"""Readings of one pose whose differences are counted."""


@dataclass(frozen=True, eq=False)
class Copies:
    """Positions of the rows that equal an earlier one in every column.

    by_chance: whether so many may agree because the readings are coarse, so that all count.
    """

    rows: Positions
    by_chance: bool

    @property
    def copied(self) -> Positions:
        """The rows that are copies."""
        return self.rows[:0] if self.by_chance else self.rows


_NONE = Copies(np.zeros(0, dtype=np.intp), True)


def copies(data: Dataset, quantities: Sequence[str], outputs: Collection[str]) -> Copies:
    """The rows that equal an earlier one in all of these quantities.

    outputs: those that an instrument reads while the others say where the machine stands. None
    where they were sought already or rows were taken several times on purpose (`Source.judged`).
    """
    names = [q for q in quantities if q in data.readings]
    read = [q for q in names if q in outputs]
    if data.source.judged or not names or len(data) < 2:
        return _NONE
    if not read:  # what was set and what was read cannot be distinguished
        return _NONE
    measured = np.isfinite([data.readings[q] for q in read]).any(axis=0)
    first, of = _alike(_numbers(data, names))
    again = np.flatnonzero((first[of] != np.arange(len(data))) & measured)
    if not again.size:
        return _NONE
    driven = [q for q in names if q not in outputs]
    expected = _by_chance(data, driven, read, of, again) if driven else 0.0
    return Copies(again, not _rare(again.size, expected))


def _numbers(data: Dataset, names: Sequence[str]) -> Array:
    """(k, N) readings, and the sds that came with them; one kind of zero and of NaN."""
    rows = [data.readings[q] for q in names] + [data.sds[q] for q in names if q in data.sds]
    numbers = np.array(rows).reshape(len(rows), len(data)) + 0.0
    numbers[np.isnan(numbers)] = np.nan
    return numbers


def _alike(rows: Array) -> tuple[Positions, Positions]:
    """The first of each kind of column of rows (k, N), and which kind every column is (N,)."""
    flat = np.ascontiguousarray(rows.T)
    keys = flat.view(np.dtype((np.void, flat.dtype.itemsize * flat.shape[1]))).ravel()
    _, first, of = np.unique(keys, return_index=True, return_inverse=True)
    return first, of.ravel()


def _by_chance(
    data: Dataset, driven: list[str], read: list[str], kind: Positions, again: Positions
) -> float:
    """How many rows may agree by chance; kind: which kind of row every row is (N,)."""
    _, pose = _alike(_numbers(data, driven))
    levels = np.array([data.readings[q] for q in read])
    _, level = _alike(_numbers(data, read))
    _, first = np.unique(kind, return_index=True)
    # A value that other poses have taken too lies on a step so coarse that agreement is no news.
    taken_by = np.bincount(level[first])  # poses, for a kind is a reading of a pose
    shared = float(np.count_nonzero(taken_by[level[again]] > 1))
    one, other = _pairs(pose[first])
    count = np.bincount(kind).astype(float)
    weight, one, other = count[one] * count[other], first[one], first[other]
    apart = np.abs(levels[:, one] - levels[:, other])
    apart[~(apart > _SAME * np.nanmax(np.abs(levels)))] = 0.0  # NaN: what neither row measured
    if len(read) > 1:
        apart_in = np.count_nonzero(apart, axis=0)
        return _OFTEN * shared + _agreeing(apart_in[apart_in > 0], weight[apart_in > 0])
    order = np.argsort(levels[0, one] + levels[0, other], kind="stable")
    order = order[apart[0, order] > 0.0]
    parts = np.array_split(order, max(1, len(order) // _LIKE)) if order.size else []
    steps = [np.round(np.minimum(apart[0, part] / apart[0, part].min(), 3.0)) for part in parts]
    return _OFTEN * shared + _agreeing(np.concatenate([*steps, []]).astype(int), weight[order])


def _pairs(pose: Positions) -> tuple[Positions, Positions]:
    """Positions of the two of every pair of the same pose."""
    order = np.argsort(pose, kind="stable")
    places = np.split(order, np.flatnonzero(np.diff(pose[order])) + 1)
    several = [place[:_MOST] for place in places]
    one, other = zip(*(np.triu_indices(len(place), 1) for place in several), strict=True)
    return (
        np.concatenate([place[i] for place, i in zip(several, one, strict=True)]),
        np.concatenate([place[i] for place, i in zip(several, other, strict=True)]),
    )


def _agreeing(steps: NDArray[np.int64], weight: Array) -> float:
    """How many pairs may agree, from the weights of pairs that differ by 1, 2, ... steps.

    What is too rare to be seen follows from what is not: n_1 from n_2 and n_3 as n_0 from those.
    """
    if steps.size and steps.max() == 1:
        return math.inf
    count = np.bincount(steps, weight, minlength=3)
    for n in reversed(range(len(count) - 2)):
        # n_0 <= n_1^2 / (2 n_2), as derived above; an n_2 that was not seen counts as 1.
        count[n] = max(count[n], count[n + 1] ** 2 / (2.0 * max(count[n + 2], 1.0)))
    return float(count[0])


def _rare(number: int, expected: float) -> bool:
    """Whether so many are improbable: P(Poisson >= n) = P(chi-squared of 2n < 2 expected)."""
    if expected <= 0.0:
        return True
    if expected >= number:
        return False
    return chi_squared.lower(2.0 * expected, 2 * number) <= CHANCE
