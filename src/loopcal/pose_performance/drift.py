"""Drift dAP and dRP: how accuracy and repeatability of a pose change from block to block.

dAP = |AP_last - AP_first|, dRP = |RP_last - RP_first| (ISO 9283), blocks in the order of time.
Errors that all readings of a pose share turn the mean of every block alike; they enter dAP only as
far as the direction of the offset changes. A robot that drifts across its offset hardly changes its
AP, so the shift of the mean position is given beside it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.pose_performance.accuracy import covariance_of_mean
from loopcal.pose_performance.intervals import (
    Estimate,
    NormalScatter,
    length_interval,
    repeatability,
    size_interval,
)
from loopcal.pose_performance.parts import Block, Drift

Array = NDArray[np.float64]
CYCLES = 10
"""Cycles of a block where no column names the blocks."""


def blocks_of(
    rows: NDArray[np.intp], named: Sequence[str] | None, time: Array | None
) -> list[NDArray[np.intp]]:
    """Rows of one pose in blocks, in order: as named, else ten successive cycles by time.

    What is left over belongs to the last block. Less than two blocks are returned as they are.
    """
    if named is not None:
        names = list(dict.fromkeys(named[i] for i in rows))
        return [np.array([i for i in rows if named[i] == name]) for name in names]
    if time is None:
        return []
    ordered = rows[np.argsort(time[rows], kind="stable")]
    count = max(len(rows) // CYCLES, 1)
    ends = [CYCLES * k for k in range(1, count)]
    return list(np.split(ordered, ends))


def drift(
    pose: str,
    blocks: Sequence[NDArray[np.intp]],
    offsets: Array,
    common: Array,
    seen: tuple[Sequence[str] | None, Array | None],
) -> Drift:
    """The drift of one pose; offsets (N, 3): measured minus commanded, of all rows [m].

    common: covariance (3, 3) of what all readings share; seen: names of blocks and times per row.
    """
    named, time = seen
    made = []
    for number, rows in enumerate(blocks, 1):
        scatter = covariance_of_mean(offsets[rows])
        made.append(
            Block(
                named[rows[0]] if named is not None else str(number),
                None if time is None else float(time[rows].mean()),
                len(rows),
                length_interval(
                    offsets[rows].mean(axis=0), scatter + common, scatter, len(rows) - 1.0
                ),
                repeatability(offsets[rows]),
            )
        )
    first, last = offsets[blocks[0]], offsets[blocks[-1]]
    return Drift(
        pose,
        tuple(made),
        _shift(first, last),
        _change_of_accuracy(first, last, common),
        _change_of_repeatability(first, last),
    )


def _shift(first: Array, last: Array) -> Estimate:
    """Distance of the means; what all readings share cancels."""
    scatter = covariance_of_mean(first) + covariance_of_mean(last)
    degrees = min(len(first), len(last)) - 1.0
    return length_interval(last.mean(axis=0) - first.mean(axis=0), scatter, scatter, degrees)


def _change_of_accuracy(first: Array, last: Array, common: Array) -> Estimate:
    means = [part.mean(axis=0) for part in (first, last)]
    lengths = [float(np.linalg.norm(mean)) for mean in means]
    # d|m| = u . dm, so the variance of a length is u^T C u to first order.
    u = [mean / (length or 1.0) for mean, length in zip(means, lengths, strict=True)]
    scatters = [covariance_of_mean(part) for part in (first, last)]
    by_scatter = sum(float(a @ S @ a) for a, S in zip(u, scatters, strict=True))
    # An error common to both blocks moves the lengths by u_1 . e and u_0 . e.
    shared = float((u[1] - u[0]) @ common @ (u[1] - u[0]))
    degrees = min(len(first), len(last)) - 1.0
    return size_interval(lengths[1] - lengths[0], by_scatter, by_scatter + shared, degrees)


def _change_of_repeatability(first: Array, last: Array) -> Estimate:
    """RP is nearly normal with the variance RP^2 / (2 degrees)."""
    figures = [repeatability(part) for part in (first, last)]
    variance = 0.0
    for part, figure in zip((first, last), figures, strict=True):
        scatter = NormalScatter.of(np.atleast_2d(np.cov(part.T)))
        variance += (
            figure.value**2 / (2.0 * scatter.degrees(len(part))) if scatter.sd > 0.0 else 0.0
        )
    degrees = min(len(first), len(last)) - 1.0
    return size_interval(figures[1].value - figures[0].value, variance, variance, degrees)
