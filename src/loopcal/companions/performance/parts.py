"""The figures of pose performance as typed values [SI].

Drift dAP and dRP: how accuracy and repeatability of a pose change from block to block.

dAP = |AP_last - AP_first|, dRP = |RP_last - RP_first| (ISO 9283), blocks in the order of time.
Errors that all readings of a pose share turn the mean of every block alike; they enter dAP only as
far as the direction of the offset changes. A robot that drifts across its offset hardly changes its
AP, so the shift of the mean position is given beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.performance.accuracy import covariance_of_mean
from loopcal.companions.performance.intervals import (
    Estimate,
    NormalScatter,
    length_interval,
    repeatability,
    size_interval,
)


@dataclass(frozen=True)
class AxisPerformance:
    """Orientation about one axis of the base: accuracy (signed) and repeatability (+-) [rad]."""

    axis: str
    accuracy: Estimate
    accuracy_fitted: Estimate | None
    repeatability: Estimate


@dataclass(frozen=True)
class PosePerformance:
    """One commanded pose, approached from one direction.

    accuracy: AP [m]; accuracy_fitted: AP after the base frame was fitted to the measured poses;
    offset: mean measured minus commanded (x, y, z) [m]; repeatability: RP [m]; instrument: RP that
    the instrument alone would show [m], and instrument_share: its part of the variance, None where
    its sd is not stated.
    """

    pose: str
    direction: str | None
    cycles: int
    accuracy: Estimate
    accuracy_fitted: Estimate | None
    offset: tuple[float, ...]
    repeatability: Estimate | None
    instrument: float | None = None
    instrument_share: float | None = None
    orientation: tuple[AxisPerformance, ...] = ()

    @property
    def name(self) -> str:
        """The pose, and its direction where there are several."""
        return self.pose if self.direction is None else f"{self.pose}, {self.direction}"


@dataclass(frozen=True)
class DirectionVariation:
    """vAP: largest distance between the mean positions of directions of approach [m]."""

    pose: str
    directions: tuple[str, ...]
    variation: Estimate


@dataclass(frozen=True)
class DistancePerformance:
    """Distance of two poses: commanded [m], accuracy AD [m], repeatability RD (+-) [m]."""

    poses: tuple[str, str]
    cycles: int
    commanded: float
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Block:
    """Cycles of one pose taken together, at a mean time [s] where time is known."""

    name: str
    time: float | None
    cycles: int
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Drift:
    """Last block of cycles against the first [m]: shift of the mean position, dAP, dRP."""

    pose: str
    blocks: tuple[Block, ...]
    shift: Estimate
    accuracy: Estimate
    repeatability: Estimate


@dataclass(frozen=True)
class Largest:
    """The poses whose AP, AP after fitting the base, and RP are the largest of a condition."""

    accuracy: PosePerformance
    fitted: PosePerformance | None
    repeatability: PosePerformance | None

    @property
    def figures(self) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
        """AP, AP fitted and RP of these poses."""
        return (
            self.accuracy.accuracy,
            None if self.fitted is None else self.fitted.accuracy_fitted,
            None if self.repeatability is None else self.repeatability.repeatability,
        )


@dataclass(frozen=True)
class ConditionPerformance:
    """All figures at one payload and speed.

    condition: column -> value; missing: what could not be computed, and why; notes: what a reader
    of the figures must know.
    """

    condition: Mapping[str, str]
    poses: tuple[PosePerformance, ...]
    variations: tuple[DirectionVariation, ...]
    distances: tuple[DistancePerformance, ...]
    drifts: tuple[Drift, ...]
    missing: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The condition in words; empty where the table has no such columns."""
        return ", ".join(f"{key} = {value}" for key, value in self.condition.items())

    @property
    def largest(self) -> Largest:
        """Poses with the largest AP, AP after fitting the base, and RP."""

        def most(figure: Callable[[PosePerformance], Estimate | None]) -> PosePerformance | None:
            valued = [(e.value, pose) for pose in self.poses if (e := figure(pose)) is not None]
            return max(valued, key=lambda pair: pair[0])[1] if valued else None

        worst = most(lambda pose: pose.accuracy)
        assert worst is not None  # a condition has poses
        return Largest(
            worst,
            most(lambda pose: pose.accuracy_fitted),
            most(lambda pose: pose.repeatability),
        )


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
