"""What a plan is made from beside the machine and its noise: where poses may be measured.

Boxes are in the frame of the machine's base; without a station, in that of the readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, unknown_name
from loopcal.measurements.dataset import Dataset

Mask = NDArray[np.bool_]
Span = tuple[float, float]
MODEL_ERRORS = ("structured", "none")


@dataclass(frozen=True)
class Box:
    """From low to high (3,) [m]; an infinite side is open."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def holds(self, at: Array) -> Mask:
        """Which points (d, N) lie inside."""
        low, high = (np.array(side)[: len(at), None] for side in (self.low, self.high))
        return np.asarray(((at >= low) & (at <= high)).all(axis=0))

    def crossed(self, a: Array, b: Array) -> Mask:
        """Which segments from a (d, N) to b (d, N) touch it."""
        low, high = (np.array(side)[: len(a), None] for side in (self.low, self.high))
        way = b - a
        flat = np.abs(way) < 1e-12
        safe = np.where(flat, 1.0, way)
        # Slabs: the segment is inside between the last entry into a slab and the first exit from
        # one.
        first, last = (low - a) / safe, (high - a) / safe
        enter = np.where(flat, -np.inf, np.minimum(first, last)).max(axis=0)
        leave = np.where(flat, np.inf, np.maximum(first, last)).min(axis=0)
        beside = (flat & ((a < low) | (a > high))).any(axis=0)
        crossing: Mask = ~beside & (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0))
        return crossing


@dataclass(frozen=True)
class Sight:
    """What the instrument can see.

    station: where it stands in the frame of its readings [m]; normal: the direction in the body's
    frame that the reflector looks along; within: the largest angle [rad] between it and the line
    to the instrument. Without a normal only keep-out boxes block the line of sight.
    """

    station: tuple[float, ...] = (0.0, 0.0, 0.0)
    normal: tuple[float, ...] | None = None
    within: float = math.radians(30.0)


@dataclass(frozen=True, eq=False)
class PlanSettings:
    """What a plan is made from, beside the machine and its noise.

    ranges: quantity -> range [SI], by default the joints' limits, or the ranges of poses already
    measured; region: the same for the poses whose end point counts, by default the candidates;
    reach: where the end point must be; keep_out: what neither end point, nor links of a serial arm,
    nor line of sight may touch; forbidden: readings near which no pose may be; number: of random
    candidates; model_error: "structured" counts what geometry does not explain among the
    parameters, "none" does not; seed: of the random candidates; repeats: whether the first pose is
    measured again in the middle and at the end; occasions: for each kind of pose the
    instruments that serve it, by default those of poses already measured.

    Raises InputError for a number below 1 and an unknown model_error.
    """

    ranges: Mapping[str, Span] = field(default_factory=dict)
    region: Mapping[str, Span] = field(default_factory=dict)
    reach: Box | None = None
    keep_out: tuple[Box, ...] = ()
    sight: Sight | None = None
    forbidden: Dataset | None = None
    number: int = 3000
    model_error: str = "structured"
    seed: int = 0
    repeats: bool = True
    occasions: tuple[tuple[str, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.number < 1:
            raise InputError(
                f"{self.number} candidates are requested",
                code="invalid-value",
                remedy="request at least as many candidates as poses",
            )
        if self.model_error not in MODEL_ERRORS:
            raise unknown_name(
                f"there is no model_error {self.model_error!r}", self.model_error, MODEL_ERRORS
            )
