"""How readings usually err: each by its sd, the pixels of an image shifted and stretched as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.mechanism import PIXELS


def image_modes(problem: Problem) -> Array:
    """(k, q) changes of all readings by their sds [SI], six columns for each camera; q is 0 without
    one.

    x and y of a point are the mean of its pixels over the poses, from the middle of all.
    """
    names, columns = problem.mechanism.tape.quantities, []
    for family in problem.mechanism.families:
        if family.form != PIXELS:
            continue
        index = [names.index(q) for q in family.readings]
        sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[index]
        pixels = np.where(np.isinf(sd), np.nan, problem.readings[index])
        seen = np.isfinite(pixels)
        mean = np.where(seen, pixels, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        xy = mean.reshape(-1, 2)
        xy = xy - xy.mean(axis=0)
        over = np.column_stack([np.ones(len(xy)), xy])
        over /= np.maximum(np.sqrt(np.square(over).mean(axis=0)), 1e-12)
        for axis in (0, 1):
            modes = np.zeros((len(names), 3))
            modes[index[axis::2]] = units_of(problem, index)[axis::2, None] * over
            columns.append(modes)
    return np.concatenate(columns, axis=1) if columns else np.zeros((len(names), 0))


def units_of(problem: Problem, rows: Sequence[int]) -> Array:
    """(q,) the usual sd of each reading [SI]; 1 where they are taken as exact."""
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[list(rows)]
    usable = np.isfinite(sd) & (sd > 0.0)
    if not usable.any(axis=1).all():
        return np.ones(len(rows))
    return np.array([float(np.median(row[mask])) for row, mask in zip(sd, usable, strict=True)])
