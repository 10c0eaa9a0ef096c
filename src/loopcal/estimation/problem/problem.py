"""One calibration as arrays: readings, uncertainties, nominal values, poses cut into blocks.

Whether there are equations enough to calibrate from: the calibration index.

In a pose with k quantities in m loops a mechanism has the mobility M = k - m; with u of them
unmeasured, S = k - u are sensed. C = S - M = m - u equations are left for the parameters.
Hollerbach and Wampler (1996).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.constants import constants_by_pose, standing_exact, with_implied
from loopcal.estimation.problem.patterns import Pattern, Poses, patterns_of
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.expressions.tape import Tape
from loopcal.lazy import cached_property
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, ReadingUncertainty, resolve_noise
from loopcal.mechanisms.mechanism import PIXELS, Mechanism

# What the loops of a pose count in a fit, and where they are linearised for it.


class Weighting(Enum):
    """CORRECTED: by the sds of the readings, where these are corrected to (maximum likelihood).

    READ: by the same sds, with derivatives by the parameters where the readings stand (reweighted
    least squares). ALIKE: every loop alike and no prior, the readings taken as exact (3.1 to 3.6
    of the thesis).
    """

    CORRECTED = "corrected"
    READ = "read"
    ALIKE = "alike"


BLOCK = 4096
"""Poses per block: large enough that NumPy's overhead vanishes, small enough for the cache."""
VALUES = 1_000_000
"""Derivatives of a block at most, 8 MB: poses with many loops or parameters come in fewer. What is
made of a block is several times as large, and a fit with a model error has hundreds of columns."""


def most_poses(tape: Tape, parameters: int) -> int:
    """Poses in a block at most, of derivatives by so many parameters and all quantities."""
    each = len(tape.loops) * (len(tape.quantities) + parameters)
    return max(1, min(BLOCK, VALUES // max(each, 1)))


@dataclass(frozen=True)
class Problem:
    """Everything a fit needs, in SI units and the orders of the tape.

    readings: (k, N), a start value where unmeasured; pose_constants: (c, N); uncertainty: of every
    reading; start: (n_all,) all parameters; free: positions of the n estimated ones; nominal,
    prior_sd: (n,) of these; poses: the ids; weighting: what its loops count.
    first_corrections: (k, N) those from which the search for unmeasured quantities begins, where a
    fit of nearly the same problem ended with them.
    """

    mechanism: Mechanism
    readings: Array
    pose_constants: Array
    uncertainty: ReadingUncertainty
    start: Array
    free: NDArray[np.intp]
    nominal: Array
    prior_sd: Array
    poses: tuple[str, ...]
    patterns: tuple[Pattern, ...] = field(default=())
    first_corrections: Array | None = None
    weighting: Weighting = Weighting.CORRECTED

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        everything = self.mechanism.parameters.names
        return tuple([everything[i] for i in self.free.tolist()])

    @property
    def unknowns(self) -> Unknowns:
        """What is estimated, apart from the poses."""
        stated = Unknowns(self.start, self.free, self.names, self.nominal, self.prior_sd)
        return stated.without_prior() if self.loops_alike else stated

    @property
    def loops_alike(self) -> bool:
        """Whether the readings are taken as exact, so that neither sds nor prior count."""
        return self.weighting is Weighting.ALIKE

    @property
    def precision(self) -> Array:
        """(n,) 1 / prior variance of the estimated parameters."""
        return 1.0 / np.square(self.unknowns.prior_sd)

    def weighted(self, weighting: Weighting) -> Problem:
        """The same readings with loops that count otherwise."""
        return self if weighting is self.weighting else replace(self, weighting=weighting)

    @property
    def where_closed(self) -> Problem:
        """The same, linearised where its loops close."""
        return self if self.loops_alike else self.weighted(Weighting.CORRECTED)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """SI units of the estimated parameters."""
        everything = self.mechanism.parameters.items
        return tuple([everything[i].unit for i in self.free.tolist()])

    @cached_property
    def equations(self) -> int:
        """Loop equations over all poses, less the unmeasured quantities they determine."""
        return sum(p.equations(len(self.poses)) - self._missing(p) for p in self.patterns)

    def _missing(self, pattern: Pattern) -> int:
        """Loops of a pattern that count nothing, because their own reading is missing."""
        sd = np.broadcast_to(self.uncertainty.sd, self.readings.shape)[list(pattern.predicted)]
        return int(np.isinf(sd[:, pattern.poses]).sum())

    @property
    def count(self) -> int:
        """How many poses there are."""
        return len(self.poses)

    def with_nominal(self, mechanism: Mechanism) -> Problem:
        """The problem of a mechanism that differs in nominal values alone, begun at these."""
        values = np.array([p.nominal for p in mechanism.parameters])
        return replace(self, mechanism=mechanism, start=values, nominal=values[self.free])

    def pose(self, number: int) -> str:
        """The id of the pose at a position."""
        return self.poses[number]

    def tape(self, pattern: Pattern) -> Tape:
        """The loops that hold in the poses of a pattern."""
        return self.mechanism.tape.only(pattern.loops)

    @property
    def block(self) -> int:
        """Poses in a block: at most `most`, and so many that all blocks are about as long."""
        return self._block(self.most)

    @property
    def most(self) -> int:
        """Poses in a block at most."""
        return most_poses(self.mechanism.tape, len(self.free))

    def _block(self, most: int) -> int:
        poses = len(self.poses)
        return math.ceil(poses / math.ceil(poses / most))

    def blocks(self, most: int | None = None) -> Iterator[tuple[Pattern, Poses]]:
        """The poses in blocks, each with its pattern; a pose without any loop is in none."""
        size = self._block(self.most if most is None else most)
        for pattern in self.patterns:
            if isinstance(pattern.poses, slice):
                for begin in range(0, len(self.poses), size):
                    yield pattern, slice(begin, min(begin + size, len(self.poses)))
            else:
                for begin in range(0, len(pattern.poses), size):
                    yield pattern, pattern.poses[begin : begin + size]


def build_problem(
    mechanism: Mechanism,
    dataset: Dataset,
    noise: Noise | None,
    start: Mapping[str, float] | None = None,
    *,
    whole: bool = True,
) -> Problem:
    """The problem of calibrating a mechanism from a data set.

    noise: None takes every reading as exact, as the basic method does; start: parameter values
    [SI] to begin from, where not the nominal ones; whole: these are all poses, not a chunk of them.

    Raises InputError where readings or sds are missing, or a unit does not fit. Also where there
    are fewer equations than parameters, or nothing says how large the machine is.
    """
    quantities = mechanism.tape.quantities
    dataset = with_implied(mechanism, dataset)
    _check_units(mechanism, dataset)
    stated = noise is not None
    if noise is None:
        noise, dataset = _exact(mechanism, dataset), replace(dataset, sds={})
    uncertainty = resolve_noise(noise, dataset, quantities, mechanism.quantity_group)
    if dataset.counts:
        single = np.ones(len(dataset))
        counts = np.array([dataset.counts.get(q, single) for q in quantities])
        uncertainty = uncertainty.of_means(counts)
    missing = np.full(len(dataset), np.nan)
    raw = np.array([dataset.readings.get(q, missing) for q in quantities])
    if whole:  # a chunk may stand still where the others move
        uncertainty = standing_exact(mechanism, raw, uncertainty)
    constants = constants_by_pose(mechanism, dataset)
    parameters = mechanism.parameters
    values = {p.name: p.nominal for p in parameters} | dict(start or {})
    free = np.array([i for i, p in enumerate(parameters) if not p.fixed], dtype=np.intp)
    if not free.size:
        raise InputError(
            "every parameter is fixed, so there is nothing to estimate",
            code="no-free-parameter",
            remedy="free at least one parameter",
        )
    estimated = [p for p in parameters if not p.fixed]
    problem = Problem(
        mechanism,
        _filled(raw, [mechanism.home.get(q, 0.0) for q in quantities]),
        constants,
        uncertainty,
        np.array([values[n] for n in parameters.names]),
        free,
        np.array([p.nominal for p in estimated]),
        np.array([p.prior_sd for p in estimated]),
        dataset.poses,
        patterns_of(mechanism, uncertainty),
    )
    refuse_without_redundancy(mechanism, problem.patterns, problem.poses)
    if whole:
        refuse_too_few(problem.equations, problem.count, problem.unknowns)
    return problem if stated else problem.weighted(Weighting.ALIKE)


def taken(problem: Problem, index: NDArray[np.intp]) -> Problem:
    """The same problem on the poses at these positions, in this order; a pose may come twice."""
    uncertainty = problem.uncertainty.of(index)
    return replace(
        problem,
        readings=problem.readings[:, index],
        pose_constants=problem.pose_constants[:, index],
        uncertainty=uncertainty,
        poses=tuple(problem.poses[i] for i in index),
        patterns=patterns_of(problem.mechanism, uncertainty),
        first_corrections=None
        if problem.first_corrections is None
        else problem.first_corrections[:, index],
    )


def left_unmeasured(problem: Problem, without: NDArray[np.bool_]) -> Problem:
    """The same problem with the readings marked in `without`, (k, N), unknown.

    The loops that hold stay the same: an instrument's only reading is then found from its loop.
    """
    sd = np.where(without, np.inf, problem.uncertainty.sd)
    blind = np.broadcast_to(np.isinf(problem.uncertainty.sd), sd.shape)
    uncertainty = replace(problem.uncertainty, sd=sd)
    patterns = patterns_of(problem.mechanism, uncertainty, blind)
    return replace(problem, uncertainty=uncertainty, patterns=patterns)


def _exact(mechanism: Mechanism, dataset: Dataset) -> Noise:
    """Every reading exact; unmeasured are instruments without readings and what has a home.

    Raises InputError for any other quantity without readings.
    """
    names = mechanism.tape.quantities
    unread = {q for q in names if not np.isfinite(dataset.readings.get(q, np.nan)).any()}
    instruments = [
        f.readings for f in mechanism.families if f.form == PIXELS or unread.issuperset(f.readings)
    ]
    unmeasured = unread & {*mechanism.home, *(q for readings in instruments for q in readings)}
    for name in names:
        if name in unread - unmeasured:
            raise InputError(
                f"least squares has no readings of the quantity {name!r}",
                code="missing-reading",
                remedy=f"name its column; if {name!r} is not measured, use another method and give "
                "it the sd inf",
            )
    return Noise({q: math.inf if q in unmeasured else 0.0 for q in names})


def _check_units(mechanism: Mechanism, dataset: Dataset) -> None:
    for name, unit in {**mechanism.quantities, **mechanism.pose_constants}.items():
        unit_of_data = dataset.units.get(name)
        if unit_of_data is not None and unit_of_data != unit:
            raise InputError(
                f"the readings of {name!r} are in {unit_of_data}, but the mechanism needs {unit}",
                code="wrong-unit",
                remedy=f"state a unit for column {name!r} that converts to {unit}",
            )


def _filled(raw: Array, home: Sequence[float]) -> Array:
    """Readings with a start value where there is none: between the neighbours in pose order.

    home: a start for each quantity without any reading.
    """
    if not np.isnan(raw).any():
        return raw
    filled = raw.copy()
    order = np.arange(raw.shape[1])
    for row, usual in zip(filled, home, strict=True):
        gaps = np.isnan(row)
        if gaps.all():
            row[:] = usual
        elif gaps.any():
            row[gaps] = np.interp(order[gaps], order[~gaps], row[~gaps])
    return filled


def refuse_too_few(equations: int, poses: int, unknowns: Unknowns) -> None:
    """Raises InputError where fewer parameters can be determined than are estimated."""
    # A finite prior is one more equation.
    needed = len(unknowns.free) - int(np.isfinite(unknowns.prior_sd).sum())
    if equations < needed:
        raise InputError(
            f"{equations} loop equations ({poses} poses) cannot determine {needed} parameters "
            "without prior knowledge",
            code="too-few-poses",
            remedy="measure more poses, fix parameters, or give them a finite prior sd",
        )


def refuse_without_redundancy(
    mechanism: Mechanism, patterns: Sequence[Pattern], poses: Sequence[str]
) -> None:
    """Raises InputError where the loops of some pose cannot find what is unmeasured there.

    Likewise where the loops of all poses find that and nothing else. poses: their ids.
    """
    for pattern in patterns:
        if len(pattern.unmeasured) > len(pattern.loops):
            raise _blind(mechanism, pattern, poses)
    if sum(pattern.equations(len(poses)) for pattern in patterns) <= 0:
        raise _without_redundancy(mechanism, patterns)


def _blind(mechanism: Mechanism, pattern: Pattern, poses: Sequence[str]) -> InputError:
    """A pose whose unmeasured quantities could stand anywhere."""
    first = 0 if isinstance(pattern.poses, slice) else int(pattern.poses[0])
    names = _unmeasured(mechanism, pattern)
    return InputError(
        f"pose {poses[first]!r} has {len(names)} unmeasured quantities "
        f"({', '.join(names)}) and only {len(pattern.loops)} loop equations to find them: its "
        f"calibration index is {_words(mechanism, pattern)}",
        code="undetermined-quantities",
        remedy="measure more quantities in this pose, or exclude it",
    )


def _without_redundancy(mechanism: Mechanism, patterns: Sequence[Pattern]) -> InputError:
    """Sensors that just say where the machine stands leave nothing to learn from."""
    if not patterns:
        return InputError(
            "no pose has enough readings to close a loop",
            code="no-data",
            remedy="name the columns of the instrument's readings",
        )
    pattern = patterns[0]
    names = _unmeasured(mechanism, pattern)
    unread = f" such as {names[0]}" if names else ""
    return InputError(
        f"{mechanism.name!r} cannot be calibrated from these sensors: its calibration "
        f"index is {_words(mechanism, pattern)}. They measure only the position of the machine, "
        f"so any parameters would fit",
        code="undetermined-quantities",
        remedy="add an instrument, or read a passive joint or another quantity that has no sensor"
        f"{unread}: each adds one equation to every pose",
    )


def _unmeasured(mechanism: Mechanism, pattern: Pattern) -> list[str]:
    return [mechanism.tape.quantities[i] for i in pattern.unmeasured]


def _words(mechanism: Mechanism, pattern: Pattern) -> str:
    k = len(mechanism.tape.quantities) - len(pattern.absent)
    m, u = len(pattern.loops), len(pattern.unmeasured)
    return f"C = S - M = {k - u} sensed - {k - m} of mobility = {m - u} in every such pose"
