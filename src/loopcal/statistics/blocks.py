"""Regions of the joint space, left out one by one: how a calibration does where it has not been.

Random folds leave out poses whose neighbours stay in the fit, so they say nothing of transfer. A
block is a cluster of the driven readings, found by k-means (MacQueen 1967; Lloyd 1982) on the
cosine and sine of angles, and on lengths over the largest range of any.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.folds import Index, Parts, Scheme, driven

Array = NDArray[np.float64]
# Chosen, not derived: k-means ends at a local optimum, and more starts cost time.
_STARTS = 20
# Chosen, not derived: a region of few poses says little, and its rms counts as much.
_SMALLEST = 1 / 3
"""A clustering whose smallest block has less than this share of an even one is a poor choice."""


def blocks(mechanism: Mechanism, data: Dataset, groups: Index, number: int) -> tuple[Index, ...]:
    """The positions left out in each block, (n,) each; groups of poses (N,) stay together.

    The tightest clustering of several starts, those with a tiny block last. The same readings give
    the same blocks. Raises InputError for fewer than two blocks, and for too few different poses.
    """
    distinct, where = np.unique(groups, return_inverse=True)
    if number < 2 or number > len(distinct):
        raise InputError(
            f"blocks is {number}, but there are {len(distinct)} different poses",
            code="too-few-poses",
            remedy=f"use 2 to {len(distinct)} blocks",
        )
    features = _features(mechanism, data)
    counts = np.bincount(where)
    centres = np.array([np.bincount(where, row) for row in features]).T / counts[:, None]
    label = _clustered(centres, counts, number)[where]
    return tuple(np.flatnonzero(label == i) for i in range(number))


def blocks_of(scheme: Scheme, mechanism: Mechanism, data: Dataset, groups: Index) -> Parts:
    """The regions that a scheme leaves out one by one."""
    indices = blocks(mechanism, data, groups, scheme.blocks or 0)
    words = f"{scheme.blocks} regions of the joint space of {len(data)} poses"
    return Parts(indices, {"blocks": scheme.blocks}, words)


def _features(mechanism: Mechanism, data: Dataset) -> Array:
    """(f, N): cosine and sine of driven angles, driven lengths over the largest range."""
    names = [q for q in driven(mechanism, data) if not np.isnan(data.readings[q]).any()]
    units = {**mechanism.quantities, **mechanism.pose_constants}
    rows: list[Array] = []
    for unit in dict.fromkeys(units[q] for q in names):
        columns = np.array([data.readings[q] for q in names if units[q] == unit])
        if unit == "rad":
            # On the circle, so that -179 and 179 degrees are near.
            rows += [*np.cos(columns), *np.sin(columns)]
        else:
            # One range for all: else a drive that hardly moves would count as much as the others.
            rows += [*(columns / (float(np.ptp(columns, axis=1).max()) or 1.0))]
    return np.array(rows).reshape(-1, len(data))


def _clustered(points: Array, weights: Index, number: int) -> Index:
    """The cluster of each point (n, f), from the best of several starts."""
    from scipy.cluster.vq import ClusterError, kmeans2

    random = np.random.Generator(np.random.PCG64(0))
    best: tuple[bool, float] | None = None
    chosen = np.arange(len(points), dtype=np.intp) * number // len(points)
    for _ in range(_STARTS):
        try:
            centres, label = kmeans2(
                points, _spread(points, number, random), minit="matrix", missing="raise"
            )
        except ClusterError:
            continue  # a cluster ran empty
        sizes = np.bincount(label, weights, number)
        inertia = float((weights * np.square(points - centres[label]).sum(axis=1)).sum())
        key = bool(sizes.min() < _SMALLEST * sizes.mean()), inertia
        if best is None or key < best:
            best, chosen = key, label.astype(np.intp)
    return chosen


def _spread(points: Array, number: int, random: np.random.Generator) -> Array:
    """Centres to begin from, each at random by its squared distance from those before it.

    Source: Arthur and Vassilvitskii (2007), k-means++.
    """
    chosen = [int(random.integers(len(points)))]
    while len(chosen) < number:
        gaps = points[:, None] - points[chosen]
        near = np.square(gaps).sum(axis=2).min(axis=1)
        total = float(near.sum())
        chance = near / total if total > 0.0 else None
        chosen.append(int(random.choice(len(points), p=chance)))
    return points[chosen]
