"""The accuracy over poses that are not kept: sums and counts instead of distances."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.accuracy import Accuracy, Apart, InstrumentAccuracy, main_unit, together

Array = NDArray[np.float64]


class Tally:
    """Mean, rms, 95th percentile and maximum of distances that are not kept.

    The percentile comes from counts in bins of 0.2 % width, the first up to SMALLEST.
    """

    # 17,500 bins of 0.2 % reach up to 1e-12 exp(35) = 1,600 [SI].
    SMALLEST, WIDTH, BINS = 1e-12, 0.002, 17_500

    def __init__(self) -> None:
        self.counts = np.zeros(self.BINS, dtype=np.int64)
        self.total = self.squares = self.largest = 0.0

    def add(self, distances: Array) -> None:
        """Add distances [SI] of any shape; missing ones (NaN) do not count."""
        values = distances[np.isfinite(distances)]
        if not values.size:
            return
        bins = np.ceil(np.log(np.maximum(values / self.SMALLEST, 1.0)) / self.WIDTH)
        bins = np.minimum(bins, self.BINS - 1).astype(np.intp)
        self.counts += np.bincount(bins, minlength=self.BINS)
        self.total += float(values.sum())
        self.squares += float(np.square(values).sum())
        self.largest = max(self.largest, float(values.max()))

    def add_other(self, other: Tally) -> None:
        """Add the distances of another tally."""
        self.counts += other.counts
        self.total += other.total
        self.squares += other.squares
        self.largest = max(self.largest, other.largest)

    def accuracy(self, unit: str) -> Accuracy | None:
        """The distances summed up; None where there were none."""
        number = int(self.counts.sum())
        if not number:
            return None
        bin_ = int(np.searchsorted(np.cumsum(self.counts), 0.95 * number))
        # A bin counts as its upper edge, which may lie beyond the largest distance.
        p95 = min(self.SMALLEST * math.exp(bin_ * self.WIDTH), self.largest)
        rms = float(np.sqrt(self.squares / number))
        return Accuracy(unit, self.total / number, rms, p95, self.largest, number)


class AccuracyTally:
    """The accuracy of a stream: a tally for every instrument's positions and orientations."""

    def __init__(self) -> None:
        self.apart: tuple[Apart, ...] = ()
        self.positions: list[Tally] = []
        self.angles: list[Tally] = []

    def add(self, apart: Sequence[Apart]) -> None:
        """Add the distances of a chunk."""
        self._begin(apart)
        for one, position, angle in zip(apart, self.positions, self.angles, strict=True):
            if one.position is not None:
                position.add(one.position)
            if one.angle is not None:
                angle.add(one.angle)

    def add_other(self, other: AccuracyTally) -> None:
        """Add the distances of another chunk."""
        self._begin(other.apart)
        for mine, other_tally in zip(
            [*self.positions, *self.angles], [*other.positions, *other.angles], strict=True
        ):
            mine.add_other(other_tally)

    def accuracy(self) -> Accuracy | None:
        """The distances of all poses summed up; None where there are none."""
        unit = main_unit(self.apart)
        if unit is None:
            return None
        main, turned = Tally(), Tally()
        by = []
        for one, position, angle in zip(self.apart, self.positions, self.angles, strict=True):
            seen = one.seen
            if seen.unit == unit:
                main.add_other(position)
            (main if unit == "rad" else turned).add_other(angle)
            of_position, of_angle = position.accuracy(seen.unit), angle.accuracy("rad")
            by.append(InstrumentAccuracy(seen.instrument, seen.station, of_position, of_angle))
        return together(main.accuracy(unit), turned.accuracy("rad"), by)

    def _begin(self, apart: Sequence[Apart]) -> None:
        if not self.apart:
            nothing = np.empty(0)
            self.apart = tuple(
                Apart(
                    one.seen,
                    None if one.position is None else nothing,
                    None if one.angle is None else nothing,
                )
                for one in apart
            )
            self.positions = [Tally() for _ in apart]
            self.angles = [Tally() for _ in apart]
