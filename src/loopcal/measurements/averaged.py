"""Repeats of a pose as one reading: their mean."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.measurements.dataset import Dataset


def averaged(data: Dataset, groups: NDArray[np.intp], read: Collection[str]) -> Dataset:
    """The poses of the same group (N,) as one, by the means of their readings.

    read: those whose errors are independent, so that a mean of n has the variance sd^2 / n; of all
    others repeats share one error. A pose keeps the id of its first row.
    """
    _, first, of = np.unique(groups, return_index=True, return_inverse=True)
    single = np.ones(len(data))

    def mean(values: Array, weights: Array = single) -> Array:
        number = np.bincount(of, weights * np.isfinite(values))
        sums = np.bincount(of, weights * np.nan_to_num(values))
        means = np.divide(sums, number, out=np.full(len(first), np.nan), where=number > 0.0)
        # Equal readings stay equal to the last digit: a joint that stands still is known by that.
        alike = np.bincount(of, values != values[first][of]) == 0
        return np.asarray(np.where(alike, values[first], means))

    independent = {*read} & {*data.readings}
    counts = {q: data.counts.get(q, single) * np.isfinite(data.readings[q]) for q in independent}
    gone = tuple(data.poses[i] for i in np.setdiff1d(np.arange(len(data)), first))
    source = replace(
        data.source,
        rows_read=data.source.rows_read or len(data),
        averaged=(*data.source.averaged, *gone),
        judged=True,
    )
    return replace(
        replace(data, source=source).take(first),
        readings={q: mean(v, counts.get(q, single)) for q, v in data.readings.items()},
        sds={q: np.sqrt(mean(np.square(v))) for q, v in data.sds.items()},
        counts={q: np.maximum(np.bincount(of, number), 1.0) for q, number in counts.items()},
    )
