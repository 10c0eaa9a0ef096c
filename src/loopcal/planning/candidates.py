"""Poses that could be measured: random ones within ranges, or a user's own, their loops closed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed
from loopcal.estimation.problem.problem import Problem
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.measurements.plan_settings import PlanSettings, Span
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.planning.rules import allowed
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate, within_reach

Array = NDArray[np.float64]
STEP = {"rad": math.radians(0.01), "m": 1e-5}
"""Steps of random readings [SI]."""
_QUARTER = 0.5 * math.pi
# What a message offers as a line to copy.
_EXAMPLES = {
    "rad": '{ from = -90, to = 90, unit = "deg" }',
    "m": '{ from = 100, to = 900, unit = "mm" }',
}
_OTHER = "{ from = 0, to = 1 }"
_ROUNDS = 10
"""Draws of random poses until enough are allowed."""
EXACT = Noise({"*": 0.0})


@dataclass(frozen=True, eq=False)
class Candidates:
    """driven: what a controller is commanded [SI]; closed: with every other reading, as it would be
    without noise; considered: how many there were; refused: how many of them each rule took; even:
    positions of those that cover their ranges evenly."""

    driven: Dataset
    closed: Dataset
    considered: int
    refused: Mapping[str, int]
    even: NDArray[np.intp]

    def take(self, which: NDArray[np.intp] | list[int]) -> Candidates:
        """Some of them."""
        even = np.flatnonzero(np.isin(which, self.even))
        return Candidates(
            self.driven.take(which), self.closed.take(which), self.considered, self.refused, even
        )


def too_few(left: int, considered: int, refused: Mapping[str, int], poses: int) -> InputError:
    """The refusal where fewer candidates are left than poses are requested."""
    lost = ", ".join(f"{rule} {count}" for rule, count in refused.items() if count)
    return InputError(
        f"only {left} of {considered} candidates may be measured; poses requested: {poses}"
        + (f" (excluded: {lost})" if lost else ""),
        code="too-few-poses",
        remedy="request fewer poses, give more candidates, or widen the limits",
    )


def ranges_of(
    mechanism: Mechanism, stated: Mapping[str, Span], measured: Dataset | None
) -> dict[str, Span]:
    """Quantity or known constant -> range [SI]: as stated, else the joints' limits, else that of
    the poses already measured.

    Turning joints of an arm then have a quarter turn either way at least. What is found by closing
    the loops has none. Raises InputError where ranges are missing.
    """
    outputs = {*mechanism.outputs, *mechanism.turns, *mechanism.implied, *mechanism.home}
    outputs |= {column for o in mechanism.orientations for column in o.columns}
    units = {**mechanism.quantities, **mechanism.pose_constants}
    limits = {q: (one.low, one.high) for q, one in joint_limits(mechanism).items()}
    ranges = {**limits, **stated}
    driven = [q for q in units if q not in outputs and q not in mechanism.disturbances]
    missing = [q for q in driven if q not in ranges]
    turning = {s.joint for s in mechanism.chain if s.joint and s.motion[0] == "r"}
    for q in missing:
        if q in mechanism.latest:
            ranges[q] = (mechanism.latest[q],) * 2
        elif measured is not None and np.isfinite(measured.readings.get(q, np.nan)).any():
            values = measured.readings[q]
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            if q in turning:
                middle = 0.5 * (low + high)
                low, high = min(low, middle - _QUARTER), max(high, middle + _QUARTER)
            ranges[q] = (low, high)
    free = len(mechanism.tape.loops) - len(mechanism.outputs)
    missing = [q for q in missing if q not in ranges and q not in mechanism.unused]
    if len(missing) > free or any(q in mechanism.pose_constants for q in missing):
        raise InputError(
            f"nothing says where {listed(missing)} may be",
            code="missing-key",
            remedy=f"add to the project [plan.ranges] with a line for each, such as "
            f"{missing[0]} = {_EXAMPLES.get(units[missing[0]], _OTHER)}; or give candidates",
        )
    return ranges


def drawn(mechanism: Mechanism, ranges: Mapping[str, Span], site: PlanSettings) -> Candidates:
    """`site.number` allowed random poses within ranges [SI], or as many as ten draws give.

    Half of them cover the ranges evenly. The others lie more often near their ends, where poses
    determine most. Each reading follows the arcsine law, which optimal designs for polynomials tend
    to (Pukelsheim 1993, Optimal Design of Experiments, chapter 9). Raises InputError where none is
    allowed.
    """
    number, parts = site.number, list[_Sifted]()
    for i in range(_ROUNDS):
        if sum(part.count for part in parts) >= number:
            break
        # A prime far above any number of rounds keeps the seeds of neighbouring plans apart.
        readings = _drawn(mechanism, ranges, number, site.seed + 1000003 * i)
        names = tuple(str(number * i + j + 1) for j in range(number))
        parts.append(_sifted(mechanism, Dataset.from_arrays(readings, poses=names), site))
    return _joined(parts, number, lambda pose: (int(pose) - 1) % number % 2 == 0)


def stated_candidates(mechanism: Mechanism, poses: Dataset, site: PlanSettings) -> Candidates:
    """These poses, without those whose loops do not close and those that are not allowed.

    Raises InputError where none is left.
    """
    return _joined([_sifted(mechanism, poses, site)], len(poses))


@dataclass(frozen=True, eq=False)
class _Sifted:
    """What is left of some poses, None where nothing is."""

    considered: int
    refused: Mapping[str, int]
    driven: Dataset | None = None
    closed: Dataset | None = None

    @property
    def count(self) -> int:
        return 0 if self.driven is None else len(self.driven)


def _sifted(mechanism: Mechanism, poses: Dataset, site: PlanSettings) -> _Sifted:
    computed = {*mechanism.outputs, *mechanism.turns, *mechanism.disturbances}
    computed |= {column for o in mechanism.orientations for column in o.columns}
    units = {**mechanism.quantities, **mechanism.pose_constants}
    readings = {q: v for q, v in poses.readings.items() if q in units and q not in computed}
    stated = np.isfinite(np.array([*readings.values()])).all(axis=0)
    readings = {q: np.where(stated, v, 0.0) for q, v in readings.items()}
    readings |= {q: np.zeros(len(poses)) for q in mechanism.disturbances}
    for q, value in mechanism.latest.items():
        readings.setdefault(q, np.full(len(poses), value))
    driven = Dataset.from_arrays(readings, units={q: units[q] for q in readings}, poses=poses.poses)
    closes = stated & within_reach(mechanism, driven)
    refused = {} if closes.all() else {"loops do not close": int((~closes).sum())}
    if not closes.any():
        return _Sifted(len(poses), refused)
    closed = simulate(mechanism, driven.take(np.flatnonzero(closes)), noise=EXACT, seed=0).dataset
    rules = allowed(mechanism, site, closed)
    refused |= rules.refused
    if not rules.poses.any():
        return _Sifted(len(poses), refused)
    closed = closed.take(np.flatnonzero(rules.poses))
    hidden = computed | (mechanism.implied.keys() - readings.keys())
    shown_quantities = [q for q in closed.readings if q in units and q not in hidden]
    shown_quantities.sort(key=lambda q: q not in readings)
    shown = Dataset.from_arrays(
        {q: closed.readings[q] for q in shown_quantities},
        units={q: units[q] for q in shown_quantities},
        poses=closed.poses,
    )
    return _Sifted(len(poses), refused, shown, closed)


def _joined(
    parts: Sequence[_Sifted], most: int, covers: Callable[[str], bool] | None = None
) -> Candidates:
    """At most so many of all that is left; covers: which poses cover the ranges evenly.

    Raises InputError where nothing is left.
    """
    considered = sum(part.considered for part in parts)
    refused: dict[str, int] = {}
    for part in parts:
        for rule, count in part.refused.items():
            refused[rule] = refused.get(rule, 0) + count
    driven = [part.driven for part in parts if part.driven is not None]
    closed = [part.closed for part in parts if part.closed is not None]
    if not driven:
        raise too_few(0, considered, refused, 1)
    rows = _one_below(driven)
    even = np.flatnonzero([covers is None or covers(pose) for pose in rows.poses])
    whole = Candidates(rows, _one_below(closed), considered, refused, even)
    return whole.take(np.arange(min(most, len(whole.driven))))


def _one_below(parts: Sequence[Dataset]) -> Dataset:
    first = parts[0]
    if len(parts) == 1:
        return first
    return Dataset.from_arrays(
        {q: np.concatenate([part.readings[q] for part in parts]) for q in first.readings},
        units=dict(first.units),
        poses=[pose for part in parts for pose in part.poses],
    )


def _drawn(
    mechanism: Mechanism, ranges: Mapping[str, Span], number: int, seed: int
) -> dict[str, Array]:
    """Random readings (number,), every other one drawn towards the ends of its range."""
    readings = {}
    for q, values in random_poses(ranges, number, seed=seed).items():
        low, high = ranges[q]
        span = high - low
        values = values.copy()
        if span > 0.0:
            # The sine of a uniform angle follows the arcsine law.
            values[1::2] = low + span * np.sin(0.5 * math.pi * (values[1::2] - low) / span) ** 2
        readings[q] = values
    return _rounded(mechanism, readings)


def _rounded(mechanism: Mechanism, readings: Mapping[str, Array]) -> dict[str, Array]:
    """As a person would type them, within their ranges but for rounding."""
    units = {**mechanism.quantities, **mechanism.pose_constants}
    rounded = {}
    for q, values in readings.items():
        step = STEP.get(units[q], 0.0)
        # Towards zero: rounding away from it could leave the range.
        rounded[q] = np.trunc(values / step) * step if step and np.ptp(values) else values
    return rounded


def typical_sds(problem: Problem) -> dict[str, float]:
    """The medians of those sds that came with the readings of measured poses, by quantity."""
    sources = problem.uncertainty.sources
    sds = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    rows = zip(problem.mechanism.tape.quantities, sources, sds, strict=True)
    finite = {q: sd[np.isfinite(sd)] for q, source, sd in rows if source == "reading"}
    return {q: float(np.median(sd)) for q, sd in finite.items() if sd.size}


def with_sds(data: Dataset, typical: Mapping[str, float]) -> Dataset:
    """The data with the typical sds of readings that came with their own."""
    sds = {q: np.full(len(data), sd) for q, sd in typical.items() if q in data.readings}
    return replace(data, sds=sds) if typical else data


def in_shares(driven: Dataset) -> Array:
    """Readings (j, N) in shares of their ranges."""
    spans = {q: float(np.ptp(v)) for q, v in driven.readings.items()}
    shares = [driven.readings[q] / s for q, s in spans.items() if s > 0.0 and math.isfinite(s)]
    return np.array(shares).reshape(-1, len(driven))
