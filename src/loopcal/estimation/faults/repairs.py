"""What may be wrong with a file as a whole, each undone in turn.

A repair is the same problem with the readings as they should have been. What is tried follows from
the units of the quantities and the forms of the instruments alone, whatever the machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.faults.misfit import unread
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.mechanisms.instruments.orientation import Orientation

# Chosen, not derived: a joint that wanders less says nothing on its sign or unit.
PARKED = 0.01
"""A quantity stands still if its readings spread over no more than this share of their size."""
# Chosen, not derived: chance alone spreads readings by hardly more than twice their sd.
NOISE = 3.0
"""In a smaller unit a column that then spreads over no more than so many sds was held still: that
removes its noise, whatever its unit."""
# Factors follow from the definitions of the units.
LENGTHS = (
    (1e-3, "in millimetres, taken as metres"),
    (1e3, "in metres, taken as millimetres"),
    (25.4, "in inches, taken as millimetres"),
    (1 / 25.4, "in millimetres, taken as inches"),
    (0.0254, "in inches, taken as metres"),
    (1 / 0.0254, "in metres, taken as inches"),
    (10.0, "in centimetres, taken as millimetres"),
    (0.1, "in millimetres, taken as centimetres"),
    (0.01, "in centimetres, taken as metres"),
    (100.0, "in metres, taken as centimetres"),
)
# Factors follow from the definitions of the units.
ANGLES = (
    (math.pi / 180, "in degrees, taken as radians"),
    (180 / math.pi, "in radians, taken as degrees"),
    (0.9, "in gon, taken as degrees"),
    (1 / 0.9, "in degrees, taken as gon"),
    (math.pi / 200, "in gon, taken as radians"),
    (200 / math.pi, "in radians, taken as gon"),
)
# Chosen, not derived: rows slip where a header or a pose is lost, one to three of them.
SHIFTS = (1, -1, 2, -2, 3, -3)
"""By how many rows the readings of the instruments may be displaced."""
# Chosen, not derived: units differ by a factor of 2.54 and more, as the distances of points may.
_APART = 0.3
"""The logarithm by which rows in another unit are larger or smaller than the others."""
_GAPS = 3
"""So many gaps are tried: poses near the instrument or the zeros of the joints leave others."""
# Chosen, not derived: what is read of one machine is about as large, and three ids show which rows
# are meant.
_LIKE, _NAMED = 3.0, 3
"""By how much a factor of sizes may be missed; ids that are named."""
# 256 combinations: chosen, not derived, with the time that they take.
MOST_SIGNS = 8
"""Of more joints than these not all combinations of signs are tried, single ones and pairs only."""


@dataclass(frozen=True, eq=False)
class Repair:
    """code: the kind of fault; quantities: those concerned; words: the fault; problem: without."""

    code: str
    quantities: tuple[str, ...]
    words: str
    problem: Problem


def repairs(problem: Problem) -> Iterator[Repair]:
    """Every repair of the problem, the simplest first where several do the same."""
    made = _Maker(problem)
    yield from made.mirrored()
    yield from made.signs()
    yield from made.units()
    yield from made.mixed_units()
    yield from made.instruments()
    yield from made.exchanged()
    yield from made.orientations()
    yield from made.rows()


class _Maker:
    def __init__(self, problem: Problem) -> None:
        self.problem, self.mechanism = problem, problem.mechanism
        self.names = self.mechanism.tape.quantities
        self.unit = [self.mechanism.quantities[name] for name in self.names]
        self.sd = sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
        aside = {*self.mechanism.disturbances, *self.mechanism.implied}
        self.real = [
            j
            for j, name in enumerate(self.names)
            if name not in aside and not np.isinf(sd[j]).all()
        ]
        x = problem.readings
        self.moving = [j for j in self.real if np.ptp(x[j]) > PARKED * np.abs(x[j]).max()]
        self.families = [f for f in self.mechanism.families if f.form != "closure"]
        groups = [f.readings for f in self.families] or [self.mechanism.outputs]
        self.seen = [[j for j in self.real if self.names[j] in readings] for readings in groups]
        outputs = {j for rows in self.seen for j in rows}
        self.driven = [j for j in self.moving if j not in outputs]

    def _changed(self, code: str, words: str, rows: Sequence[int], values: Array) -> Repair:
        readings = self.problem.readings.copy()
        readings[list(rows)] = values
        names = tuple(self.names[j] for j in rows)
        return Repair(code, names, words, replace(self.problem, readings=readings))

    def _listed(self, rows: Sequence[int]) -> str:
        names = [self.names[j] for j in rows]
        return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

    def mirrored(self) -> Iterator[Repair]:
        """An instrument whose frame is left-handed."""
        for rows in self.seen:
            lengths = [j for j in rows if self.unit[j] == "m"]
            if len(lengths) == 3:
                words = f"the frame of {self._listed(lengths)} is left-handed"
                values = self.problem.readings[lengths] * np.array([[1.0], [1.0], [-1.0]])
                yield self._changed("left-handed", words, lengths, values)

    def signs(self) -> Iterator[Repair]:
        """Columns that count the other way round, joints in all combinations."""
        x = self.problem.readings
        for j in self.moving:
            words = f"{self.names[j]} counts the other way round (sign reversed)"
            yield self._changed("reversed", words, [j], -x[[j]])
        joints = self.driven
        most = len(joints) if len(joints) <= MOST_SIGNS else 2
        if unread(self.problem):
            most = 1  # each would take a search for what nobody reads
        for number in range(2, most + 1):
            for rows in combinations(joints, number):
                words = f"{self._listed(rows)} count the other way round (signs reversed)"
                yield self._changed("reversed", words, rows, -x[list(rows)])

    def units(self) -> Iterator[Repair]:
        """Columns in another unit: one, those of an instrument, all of a kind."""
        x = self.problem.readings
        for unit, ratios in (("m", LENGTHS), ("rad", ANGLES)):
            alike = [[j] for j in self.moving if self.unit[j] == unit]
            groups = [self.driven, *self.seen, self.real]
            alike += [[j for j in rows if self.unit[j] == unit] for rows in groups]
            for rows in dict.fromkeys(tuple(rows) for rows in alike if rows):
                be = "is" if len(rows) == 1 else "are"
                moves = np.nanstd(x[list(rows)], axis=1) / NOISE
                noise = np.nanmedian(self.sd[list(rows)], axis=1)
                for ratio, words in ratios:
                    # gaps alone close where the joints hardly move
                    gaps = self.mechanism.implied and not any(self.seen)
                    if ratio < 1.0 and (gaps or (ratio * moves <= noise).all()):
                        continue
                    sentence = f"{self._listed(rows)} {be} {words}"
                    yield self._changed("unit", sentence, rows, ratio * x[list(rows)])

    def mixed_units(self) -> Iterator[Repair]:
        """What is read in another unit in some of the rows, which stand apart."""
        x = self.problem.readings
        lengths = [(group, "m", LENGTHS) for group in (*self.seen, self.driven)]
        for group, unit, ratios in (*lengths, (self.driven, "rad", ANGLES)):
            rows = [j for j in group if self.unit[j] == unit]
            sizes = np.linalg.norm(x[rows], axis=0)
            for small, large in set_apart(sizes):
                apart = float(np.median(sizes[large]) / np.median(sizes[small]))
                for ratio, words in ratios:
                    factor = max(ratio, 1.0 / ratio)
                    if not factor / _LIKE < apart < factor * _LIKE:
                        continue
                    some = np.flatnonzero(small if ratio > 1.0 else large)
                    values = x[rows].copy()
                    values[:, some] *= ratio
                    first = ", ".join(self.problem.poses[i] for i in some[:_NAMED])
                    which = f"{len(some)} poses ({first}{', ...' if len(some) > _NAMED else ''})"
                    sentence = f"{self._listed(rows)} are {words} in {which}"
                    yield self._changed("unit", sentence, rows, values)

    def instruments(self) -> Iterator[Repair]:
        """What two instruments of a kind read in each other's place, as of two hands."""
        sd = self.sd
        for one, other in combinations(zip(self.families, self.seen, strict=False), 2):
            (first, rows), (second, others) = one, other
            if [self.unit[j] for j in rows] != [self.unit[j] for j in others]:
                continue
            if len(rows) < 2 or not (np.isinf(sd[rows]) == np.isinf(sd[others])).all():
                continue  # of one reading each they are columns; unread poses would change
            words = f"the readings of {first.name!r} and {second.name!r} are exchanged"
            values = self.problem.readings[[*others, *rows]]
            yield self._changed("exchanged", words, [*rows, *others], values)

    def exchanged(self) -> Iterator[Repair]:
        """Columns of one unit in each other's place."""
        for j, other in combinations(self.real, 2):
            if self.unit[j] == self.unit[other] and {j, other} & set(self.moving):
                words = f"the columns of {self.names[j]} and {self.names[other]} are exchanged"
                values = self.problem.readings[[other, j]]
                yield self._changed("exchanged", words, [j, other], values)

    def orientations(self) -> Iterator[Repair]:
        """Measured orientations in another order, unit or direction."""
        for orientation in self.mechanism.orientations:
            positions = [
                i
                for i, n in enumerate(self.mechanism.tape.pose_constants)
                if n in orientation.columns
            ]
            if len(positions) != len(orientation.columns):
                continue
            columns = dict(
                zip(orientation.columns, self.problem.pose_constants[positions], strict=True)
            )
            names = ", ".join(orientation.columns)
            for meaning, changed in _reread(orientation, columns):
                yield self._oriented("orientation", f"{names} {meaning}", orientation, changed)
            yield from self._inverted(orientation, columns)

    def _oriented(
        self,
        code: str,
        words: str,
        orientation: Orientation,
        columns: dict[str, Array],
        point: tuple[Sequence[int], Array] | None = None,
    ) -> Repair:
        constants = self.problem.pose_constants.copy()
        for name, values in columns.items():
            constants[self.mechanism.tape.pose_constants.index(name)] = values
        problem = replace(self.problem, pose_constants=constants)
        names = orientation.columns
        if point is not None:
            readings = problem.readings.copy()
            readings[list(point[0])] = point[1]
            problem = replace(problem, readings=readings)
            names = (*(self.names[j] for j in point[0]), *names)
        return Repair(code, names, words, problem)

    def _inverted(self, orientation: Orientation, columns: dict[str, Array]) -> Iterator[Repair]:
        """The pose of the station in the target's frame, in place of the target's."""
        for family, rows in zip(self.families, self.seen, strict=True):
            if not set(orientation.turns) & set(family.readings):
                continue
            R = np.array([np.asarray(axis) for axis in orientation.axes(columns)])  # (axis, xyz, N)
            inverse = _written(orientation, np.moveaxis(R, 2, 0))
            point = [j for j in rows if self.unit[j] == "m"]
            if len(point) != 3:
                continue
            # The inverse of (R, p) is (R^T, -R^T p).
            moved = -np.einsum("axn,xn->an", R, self.problem.readings[point])
            names = ", ".join([*(self.names[j] for j in point), *orientation.columns])
            words = f"{names} hold the inverse pose (the station seen from the target)"
            yield self._oriented("pose-inverted", words, orientation, inverse, (point, moved))

    def rows(self) -> Iterator[Repair]:
        """The readings of all instruments some rows away from those of the machine."""
        problem, N = self.problem, self.problem.count
        rows = [j for group in self.seen for j in group]
        if len(problem.patterns) > 1 or not rows or not self.driven:
            return  # what is unmeasured would be displaced as well
        columns = {n for o in self.mechanism.orientations for n in o.columns}
        orientation_rows = [
            i for i, n in enumerate(self.mechanism.tape.pose_constants) if n in columns
        ]
        names = tuple(self.names[j] for j in rows)
        what = self._listed(rows)
        every = np.arange(N)
        steps = {
            f"the readings of {what} stand {_apart(shift)} beside those of the joints": _shifted(
                N, shift
            )
            for shift in SHIFTS
            if 4 * abs(shift) < N
        }
        opposite = f"the readings of {what} stand in the opposite order of those of the joints"
        steps[opposite] = (every, every[::-1])
        for words, (machine, seen) in steps.items():
            moved = taken(problem, machine)
            readings, constants = moved.readings.copy(), moved.pose_constants.copy()
            readings[rows] = problem.readings[rows][:, seen]
            constants[orientation_rows] = problem.pose_constants[orientation_rows][:, seen]
            yield Repair(
                "rows-shifted",
                names,
                words,
                replace(moved, readings=readings, pose_constants=constants),
            )


def set_apart(sizes: Array) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Which of these sizes (N,) are small and which are large, with the widest gap first.

    Zero is as large in every unit, so it is neither; nor is what is not read.
    """
    read = np.sort(sizes[sizes > 0.0])
    gaps = np.diff(np.log(read))
    for at in np.argsort(-gaps)[:_GAPS].tolist():
        if gaps[at] >= _APART:
            yield (sizes > 0.0) & (sizes <= read[at]), sizes > read[at]


def _apart(shift: int) -> str:
    """How many rows late or early, in words."""
    plural = "s" if abs(shift) > 1 else ""
    return f"{abs(shift)} row{plural} too {'late' if shift > 0 else 'early'}"


def _shifted(N: int, shift: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the machine and of the instruments that belong together."""
    every = np.arange(N)
    return (every[:-shift], every[shift:]) if shift > 0 else (every[-shift:], every[:shift])


def _reread(
    orientation: Orientation, columns: dict[str, Array]
) -> Iterator[tuple[str, dict[str, Array]]]:
    """What else the numbers of an orientation may mean, in words and as they should be."""
    names = orientation.columns
    values = [columns[name] for name in names]
    if orientation.form == "quaternion":
        last_first = dict(zip(names, [values[-1], *values[:-1]], strict=True))
        yield "hold the quaternion in the order x, y, z, w, taken as w, x, y, z", last_first
        first_last = dict(zip(names, [*values[1:], values[0]], strict=True))
        yield "hold the quaternion in the order w, x, y, z, taken as x, y, z, w", first_last
    else:
        for ratio, words in ANGLES:
            yield f"are {words}", {n: ratio * v for n, v in columns.items()}
    for one, other in combinations(names, 2):
        exchanged = {**columns, one: columns[other], other: columns[one]}
        yield f"have {one} and {other} exchanged", exchanged
    R = np.array([np.asarray(axis) for axis in orientation.axes(columns)])
    yield "hold the inverse rotation", _written(orientation, np.moveaxis(R, 2, 0))


def _written(orientation: Orientation, matrices: Array) -> dict[str, Array]:
    """The columns of rotations (N, 3, 3)."""
    from scipy.spatial.transform import Rotation

    numbers = Rotation.from_matrix(matrices).as_quat()
    # SciPy writes the scalar of a quaternion last.
    return orientation.written(numbers[:, [3, 0, 1, 2]].T)
