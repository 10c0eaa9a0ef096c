"""Poses by the loops that hold in them and by what is unmeasured there."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.mechanism import PIXELS, Mechanism

Poses = slice | NDArray[np.intp]


@dataclass(frozen=True)
class Pattern:
    """Poses in which the same loops hold and the same of their quantities are unmeasured.

    loops, unmeasured, absent: positions of these loops, of the unmeasured quantities in them, and
    of the quantities that are in none of them. predicted: for each loop the position of the reading
    that it predicts, where poses with many readings are reduced by these (`whiten_images`); such a
    reading may be missing in some of the poses, and its loop then counts nothing there.
    """

    loops: tuple[int, ...]
    unmeasured: tuple[int, ...]
    absent: tuple[int, ...]
    poses: Poses
    predicted: tuple[int, ...] = ()

    def count(self, poses: int) -> int:
        """How many poses these are, of so many."""
        return poses if isinstance(self.poses, slice) else len(self.poses)

    def equations(self, poses: int) -> int:
        """Loop equations in these poses, less the unmeasured quantities they determine; those of
        missing readings of their own count as well."""
        return self.count(poses) * (len(self.loops) - len(self.unmeasured))


def patterns_of(
    mechanism: Mechanism, uncertainty: ReadingUncertainty, blind: NDArray[np.bool_] | None = None
) -> tuple[Pattern, ...]:
    """Poses by what is unmeasured in them, by sds that are inf, and by the loops that then hold.

    A family's loops go where all its own readings are `blind` (k, N), by default unmeasured:
    eliminating these readings would leave nothing of the loops.
    """
    unmeasured = np.isinf(uncertainty.sd)
    predicted = _predicted_readings(mechanism, uncertainty)
    if predicted:
        blind = _unseen(mechanism, unmeasured if blind is None else blind)
        unmeasured = unmeasured.copy()
        unmeasured[list(predicted)] = False
    codes = np.concatenate([unmeasured, unmeasured if blind is None else blind])
    if (codes == codes[:, :1]).all():
        common = _pattern(mechanism, codes[:, 0], predicted)
        return (common,) if common.loops else ()
    unique, inverse = np.unique(codes.T, axis=0, return_inverse=True)
    alike: dict[tuple[tuple[int, ...], ...], list[int]] = {}
    patterns = [_pattern(mechanism, code, predicted) for code in unique]
    for i, pattern in enumerate(patterns):
        alike.setdefault((pattern.loops, pattern.unmeasured), []).append(i)
    return tuple(
        replace(patterns[same[0]], poses=np.flatnonzero(np.isin(inverse.ravel(), same)))
        for same in alike.values()
        if patterns[same[0]].loops
    )


def _unseen(mechanism: Mechanism, unmeasured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(k, N) the readings of families none of whose readings are there in a pose.

    Of a family that sees something none counts: images miss other corners each, and would all
    differ.
    """
    rows = {name: i for i, name in enumerate(mechanism.tape.quantities)}
    unseen = np.zeros_like(unmeasured)
    for family in mechanism.families:
        read = [rows[name] for name in family.readings if name in rows]
        unseen[read] = unmeasured[read].all(axis=0)
    return unseen


def _predicted_readings(mechanism: Mechanism, uncertainty: ReadingUncertainty) -> tuple[int, ...]:
    """For each loop the position of the reading that it predicts, where an image is read.

    Empty without images, and where such a reading shares a covariance or some of them are exact:
    these are reduced like any loops.
    """
    tape = mechanism.tape
    readings = {
        loop: reading
        for family in mechanism.families
        for loop, reading in zip(family.loops, family.readings, strict=False)
    }
    if not any(f.form == PIXELS for f in mechanism.families) or len(readings) < len(tape.loops):
        return ()
    predicted = tuple(tape.quantities.index(readings[loop]) for loop in tape.loops)
    if any(set(predicted).intersection(block.indices) for block in uncertainty.blocks):
        return ()
    sd = uncertainty.sd[list(predicted)]
    exact = sd == 0.0
    return () if exact.any() and not (exact | np.isinf(sd)).all() else predicted


def _pattern(mechanism: Mechanism, code: NDArray[np.bool_], predicted: tuple[int, ...]) -> Pattern:
    """The pattern of all poses in which this is unmeasured and, in the second half, blind."""
    tape = mechanism.tape
    unmeasured, blind = code.reshape(2, -1).tolist()
    missing = set(compress(tape.quantities, unmeasured))
    unread = set(compress(tape.quantities, blind))
    silent = {loop for f in mechanism.families if unread.issuperset(f.readings) for loop in f.loops}
    inputs = tape.depends_on("quantity")
    # One coordinate of several, not read: its loop gives its value and says nothing else.
    once = Counter(itertools.chain.from_iterable(inputs))
    alone = {q for f in mechanism.families for q in unread.intersection(f.readings)}
    alone = {q for q in alone if once[q] == 1}
    loops = [
        i for i, loop in enumerate(tape.loops) if loop not in silent and alone.isdisjoint(inputs[i])
    ]
    present = frozenset().union(*(inputs[i] for i in loops))
    places = enumerate(tape.quantities)
    return Pattern(
        tuple(loops),
        tuple(i for i, name in places if name in missing and name in present),
        tuple(i for i, name in enumerate(tape.quantities) if name not in present),
        slice(None),
        tuple([predicted[i] for i in loops]) if predicted else (),
    )
