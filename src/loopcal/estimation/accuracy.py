"""How far computed outputs are from measured ones, as positions and orientations by instrument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.document.accuracy import (
    AccuracyEntry,
    Deviation,
    Distances,
    InstrumentDeviation,
    InstrumentDistances,
)
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import POLAR, Seen, cartesian, seen_outputs


@dataclass(frozen=True)
class Accuracy:
    """Distances between computed and measured outputs [unit] where both are there.

    The computed output comes from the other readings alone, without corrections. orientation: the
    same of the angles [rad] between computed and measured orientations, None where none is measured
    or nothing else is; by: the accuracy as each instrument sees it.
    """

    unit: str
    mean: float
    rms: float
    p95: float
    max: float
    poses: int
    orientation: Accuracy | None = None
    by: tuple[InstrumentAccuracy, ...] = ()

    @classmethod
    def of(cls, distances: Array, unit: str) -> Accuracy | None:
        """From distances of any shape; missing ones (NaN) do not count."""
        distances = distances[np.isfinite(distances)]
        if not distances.size:
            return None
        return cls(
            unit,
            float(distances.mean()),
            float(np.sqrt(np.square(distances).mean())),
            float(np.percentile(distances, 95)),
            float(distances.max()),
            int(distances.size),
        )

    @property
    def distances(self) -> Distances:
        """As a document holds it."""
        return Distances(self.mean, self.rms, self.p95, self.max, self.poses)


@dataclass(frozen=True)
class InstrumentAccuracy:
    """The accuracy as one instrument sees it; station: where it stands, if anything says so."""

    instrument: str
    station: str | None
    position: Accuracy | None
    orientation: Accuracy | None

    @property
    def entry(self) -> InstrumentDistances:
        """As a document holds it."""
        return InstrumentDistances(
            self.instrument,
            self.station,
            None if self.position is None else self.position.distances,
            None if self.orientation is None else self.orientation.distances,
        )


def accuracy_entry(before: Accuracy | None, after: Accuracy | None) -> AccuracyEntry | None:
    """Both as a document holds them."""
    if before is None or after is None:
        return None
    return AccuracyEntry(
        before.unit,
        before.distances,
        after.distances,
        _deviation(before.orientation, after.orientation),
        tuple(
            InstrumentDeviation(
                one.instrument,
                one.station,
                _deviation(one.position, other.position),
                _deviation(one.orientation, other.orientation),
            )
            for one, other in zip(before.by, after.by, strict=True)
        ),
    )


def _deviation(before: Accuracy | None, after: Accuracy | None) -> Deviation | None:
    if before is None or after is None:
        return None
    return Deviation(before.unit, before.distances, after.distances)


@dataclass(frozen=True, eq=False)
class Apart:
    """Distances (N,) of what one instrument sees, NaN where one of the two is missing.

    position: [unit of `seen`]; angle: of the rotation from measured to computed [rad]; None where
    it sees no such thing.
    """

    seen: Seen
    position: Array | None
    angle: Array | None


def deviations(mechanism: Mechanism, measured: Array, differences: Array) -> tuple[Apart, ...]:
    """By instrument, from measured (c, N) and computed minus measured (c, N) [SI].

    Rows are `mechanism.compared`. Coordinates of one point make one distance, and so do range,
    azimuth and elevation, whose points are compared.
    """
    return tuple(_apart(mechanism, seen, measured, differences) for seen in seen_outputs(mechanism))


def _apart(mechanism: Mechanism, seen: Seen, measured: Array, differences: Array) -> Apart:
    names = mechanism.compared
    position = angle = None
    if seen.position:
        index = [names.index(q) for q in seen.position]
        gap = differences[index]
        if seen.form in POLAR:
            gap = cartesian(measured[index] + gap) - cartesian(measured[index])
        position = _of_points(gap) if seen.image else _lengths(gap)
    if seen.turns:
        off = differences[[names.index(q) for q in seen.turns]]
        if not seen.small:
            off = off - math.tau * np.round(off / math.tau)
        size = np.sqrt(np.square(off).sum(axis=0))
        # Small turns have the length 2 tan(angle / 2).
        angle = 2.0 * np.arctan(0.5 * size) if seen.small else size
    return Apart(seen, position, angle)


def _of_points(gap: Array) -> Array:
    """(N,) root mean square, over the points of an image that were seen, of (2 points, N)."""
    squares = np.square(gap).reshape(-1, 2, gap.shape[1]).sum(axis=1)
    seen = np.isfinite(squares)
    count = seen.sum(axis=0)
    mean = np.where(seen, squares, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean), np.nan)


def _lengths(gap: Array) -> Array:
    """(N,) lengths of the columns of (r, N); where no column is whole, those of what each has."""
    finite = np.isfinite(gap)
    if finite.all(axis=0).any():
        finite[:] = True  # what is not whole stays unknown
    squares = np.where(finite, np.square(gap), 0.0).sum(axis=0)
    return np.where(finite.any(axis=0), np.sqrt(squares), np.nan)


def main_unit(apart: Sequence[Apart]) -> str | None:
    """SI unit of the accuracy as a whole: of positions where any is seen, else of angles."""
    units = [one.seen.unit for one in apart if one.position is not None]
    if not units:
        return "rad" if any(one.angle is not None for one in apart) else None
    return "m" if "m" in units else units[0]


def main_distances(apart: Sequence[Apart]) -> Array | None:
    """Distances (i, N) that the accuracy as a whole sums up."""
    unit = main_unit(apart)
    if unit is None:
        return None
    if unit == "rad":
        return np.array([one.angle for one in apart if one.angle is not None])
    return np.array(
        [one.position for one in apart if one.seen.unit == unit and one.position is not None]
    )


def by_pose(apart: Sequence[Apart]) -> Array | None:
    """(N,) root mean square of the distances over the instruments that read the pose."""
    values = main_distances(apart)
    if values is None:
        return None
    finite = np.isfinite(values)
    squares = np.where(finite, np.square(values), 0.0).sum(axis=0)
    count = finite.sum(axis=0)
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def overall(apart: Sequence[Apart]) -> Accuracy | None:
    """The distances of all poses summed up, without those of single instruments."""
    unit, values = main_unit(apart), main_distances(apart)
    return None if unit is None or values is None else Accuracy.of(values, unit)


def accuracy(apart: Sequence[Apart]) -> Accuracy | None:
    """The distances of all poses summed up; None where there are none."""
    whole = overall(apart)
    if whole is None:
        return None
    angles = [one.angle for one in apart if one.angle is not None]
    turned = Accuracy.of(np.array(angles), "rad") if angles and whole.unit != "rad" else None
    by = [
        InstrumentAccuracy(
            one.seen.instrument,
            one.seen.station,
            None if one.position is None else Accuracy.of(one.position, one.seen.unit),
            None if one.angle is None else Accuracy.of(one.angle, "rad"),
        )
        for one in apart
    ]
    return together(whole, turned, by)


def together(
    overall: Accuracy | None, orientation: Accuracy | None, by: Sequence[InstrumentAccuracy]
) -> Accuracy | None:
    """The accuracy as a whole with its parts."""
    return overall and replace(overall, orientation=orientation, by=tuple(by))


# The accuracy over poses that are not kept: sums and counts instead of distances.


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
