"""Poses that could be measured: random ones within ranges, or a user's own, their loops closed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.planning.freedoms import beyond_freedoms, freedoms_of, moved_quantities
from loopcal.companions.planning.occasions import (
    blanked,
    blanks,
    brought_together,
    direct_readings,
    gaps_of,
    occasions,
    served,
    stated_for,
    without_direct,
)
from loopcal.companions.planning.view import faces, in_image, shown
from loopcal.errors import InputError, listed
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.measurements.plan_settings import PlanSettings, Span
from loopcal.mechanisms.chain import Step, frames, product
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.outputs import POLAR, cartesian_slopes, point_outputs, points
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.skeleton import target_names
from loopcal.mechanisms.station import Station
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate, within_reach

STEP = {"rad": math.radians(1e-3), "m": 1e-6}
"""Steps of random readings [SI]: of coarser ones a calibration could not tell that they were no
rounded readings."""
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
    next_options = ("--poses", str(left)) if left else ("--candidates", "READINGS")
    return InputError(
        f"only {left} of {considered} candidates may be measured; poses requested: {poses}"
        + (f" (excluded: {lost})" if lost else ""),
        code="too-few-poses",
        remedy="request fewer poses, give more candidates, or widen the limits"
        if left
        else "widen the limits and boxes, or choose among poses of your own",
    ).offering(*next_options)


def ranges_of(
    mechanism: Mechanism, stated: Mapping[str, Span], measured: Dataset | None
) -> dict[str, Span]:
    """Quantity or known constant -> range [SI]: as stated, else the joints' limits, else that of
    the poses already measured.

    Turning joints of an arm then have a quarter turn either way at least. What is found by closing
    the loops has none. Of closed loops as many ranges as freedoms are needed: those of the platform
    at the poses already measured come first, and the others limit what follows. Raises InputError
    where ranges are missing.
    """
    outputs = {*mechanism.outputs, *mechanism.turns, *mechanism.implied, *mechanism.home}
    outputs |= {column for o in mechanism.orientations for column in o.columns}
    units = mechanism.units
    limits = {q: (one.low, one.high) for q, one in joint_limits(mechanism).items()}
    ranges = {**limits, **stated}
    driven = [q for q in units if q not in outputs and q not in mechanism.disturbances]
    missing = [q for q in driven if q not in ranges]
    turning = {q for q, unit in mechanism.joints.items() if unit == "rad"}
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
    images = any(family.form == PIXELS for family in mechanism.families)
    if images and "wx" in mechanism.implied and not mechanism.joints:
        raise InputError(
            "the robot states poses of its flange and no joints, so poses cannot be planned",
            code="undetermined-quantities",
            remedy="take images in random order, with the hand turned by 30 deg about two axes, at "
            "several distances and in all parts of the image; or read the joints, and describe the "
            "robot to `loopcal init` (--urdf or --dh)",
        )
    if images and not any(q in ranges for q in mechanism.quantities):
        raise InputError(
            "no robot moves camera or board, so poses cannot be planned",
            code="undetermined-quantities",
            remedy="take images with the board tilted by 20 to 45 deg either way, at several "
            "distances and in all parts of the image",
        )
    free = len(mechanism.tape.loops) - len(mechanism.outputs)
    missing = [q for q in missing if q not in ranges and q not in mechanism.unused]
    open_ = len(missing) > free
    if mechanism.home:
        moved, freedoms = moved_quantities(mechanism), freedoms_of(mechanism)
        if measured is not None and sum(q in stated for q in moved) < freedoms:
            ranges = _of_measured(mechanism, measured) | ranges
        open_ = sum(q in ranges for q in moved) < freedoms
        missing = [q for q in missing if q in mechanism.pose_constants] or missing or moved
    if open_ or any(q in mechanism.pose_constants for q in missing):
        raise InputError(
            f"nothing says where {listed(missing)} may be",
            code="missing-key",
            remedy=f"add to the project [plan.ranges] with a line for each, such as "
            f"{missing[0]} = {_EXAMPLES.get(units[missing[0]], _OTHER)}; or give candidates",
        )
    return ranges


def _of_measured(mechanism: Mechanism, measured: Dataset) -> dict[str, Span]:
    """Ranges of measured joints, and of the platform where it says how these stand."""
    moved, freedoms = moved_quantities(mechanism), freedoms_of(mechanism)
    unread = [q for q in moved if not np.isfinite(measured.readings.get(q, np.nan)).any()]
    every = [q for q in moved if q not in unread]
    read = every[:freedoms]
    rows = {q: measured.readings[q] for q in (*read, *mechanism.pose_constants)}
    whole = np.flatnonzero(np.isfinite([*rows.values()]).all(axis=0))
    driven = Dataset.from_arrays({q: v[whole] for q, v in rows.items()})
    closes = np.flatnonzero(reached(mechanism, driven)) if len(read) == freedoms else whole[:0]
    if not closes.size:
        return {}
    driven = driven.take(closes)
    closed = closed_at(mechanism, driven, {})
    at = {q: closed.readings[q] for q in unread[:freedoms]}
    constants = {q: driven.readings[q] for q in mechanism.pose_constants}
    # A crank stands two ways where its coupler stands one.
    if len(at) < freedoms or not _stand_at(mechanism, at | constants, driven, read):
        at = {}
    at |= {q: measured.readings[q] for q in every}
    return {q: (float(np.nanmin(v)), float(np.nanmax(v))) for q, v in at.items()}


def _stand_at(
    mechanism: Mechanism, platform: Mapping[str, Array], driven: Dataset, joints: Sequence[str]
) -> bool:
    """Whether joints that are found from the platform stand as they do."""
    poses = Dataset.from_arrays(platform)
    if not reached(mechanism, poses).all():
        return False
    closed, units = closed_at(mechanism, poses, {}), mechanism.units
    away = [np.abs(closed.readings[q] - driven.readings[q]) / NEAR[units[q]] for q in joints]
    return bool(np.max(away) <= 1.0)


def drawn(mechanism: Mechanism, ranges: Mapping[str, Span], site: PlanSettings) -> Candidates:
    """`site.number` allowed random poses within ranges [SI], or as many as ten draws give.

    Half of them cover the ranges evenly. The others lie more often near their ends, where poses
    determine most. Each reading follows the arcsine law, which optimal designs for polynomials tend
    to (Pukelsheim 1993, Optimal Design of Experiments, chapter 9). Raises InputError where none is
    allowed.
    """
    number, parts = site.number, list[_Sifted]()
    serves = served(mechanism, site.occasions or occasions(mechanism, None), number)
    limits = {q: ranges[q] for q in beyond_freedoms(mechanism, ranges)}
    ranges = {q: span for q, span in ranges.items() if q not in limits}
    for i in range(_ROUNDS):
        if sum(part.count for part in parts) >= number:
            break
        # A prime far above any number of rounds keeps the seeds of neighbouring plans apart.
        readings = _drawn(mechanism, ranges, number, site.seed + 1000003 * i)
        names = tuple(str(number * i + j + 1) for j in range(number))
        poses = Dataset.from_arrays(readings, poses=names)
        poses, closes = brought_together(mechanism, poses, serves, ranges)
        parts.append(_sifted(mechanism, poses, site, serves, closes, limits))
    return _joined(parts, number, lambda pose: (int(pose) - 1) % number % 2 == 0)


def stated_candidates(mechanism: Mechanism, poses: Dataset, site: PlanSettings) -> Candidates:
    """These poses, without those whose loops do not close and those that are not allowed.

    Things touch if joints that move by `NEAR` at most make them; where a gap is blank they need
    not. Raises InputError where none is left.
    """
    serves = stated_for(mechanism, poses)
    spans = {
        q: (poses.readings[q] - NEAR[unit], poses.readings[q] + NEAR[unit])
        for q, unit in mechanism.joints.items()
        if q in poses.readings
    }
    filled = poses.with_readings({q: np.nan_to_num(poses.readings[q]) for q in spans})
    spans = {q: (np.nan_to_num(low), np.nan_to_num(high)) for q, (low, high) in spans.items()}
    moved, closes = brought_together(mechanism, filled, serves, spans)
    missing = {q: v for q, v in moved.readings.items() if q not in poses.readings}
    poses = poses.with_readings(missing, units={q: mechanism.quantities[q] for q in missing})
    return _joined([_sifted(mechanism, poses, site, serves, closes)], len(poses))


def blank_in(data: Dataset) -> dict[str, Mask]:
    """Reading -> (N,) where it is blank, of those that are anywhere."""
    return {q: blank for q, v in data.readings.items() if (blank := np.isnan(v)).any()}


def closed_at(mechanism: Mechanism, driven: Dataset, blank: Mapping[str, Mask]) -> Dataset:
    """What would be read of these candidates at another machine, and where nothing would be.

    Contacts are off by what that machine makes of them.
    """
    machine = without_direct(mechanism)
    data = simulate(machine, _driven(mechanism, driven), noise=EXACT, seed=0).dataset
    direct = direct_readings(mechanism, data)
    # What is blank is so before it is any reading: a board beside a camera is infinitely far away.
    for q in direct.keys() & blank.keys():
        direct[q] = np.where(blank[q], np.nan, direct[q])
    return blanked(data.with_readings(direct), blank)


def reached(mechanism: Mechanism, driven: Dataset) -> Mask:
    """(N,) the candidates that another machine can reach too, whatever its contacts."""
    return within_reach(without_direct(mechanism), _driven(mechanism, driven))


def _driven(mechanism: Mechanism, poses: Dataset) -> Dataset:
    """The poses without gaps, which their joints decide."""
    kept = {q: v for q, v in poses.readings.items() if q not in gaps_of(mechanism)}
    units = {q: unit for q, unit in poses.units.items() if q in kept}
    return Dataset.from_arrays(kept, units=units, poses=poses.poses)


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


def _sifted(
    mechanism: Mechanism,
    poses: Dataset,
    site: PlanSettings,
    serves: Mask,
    touches: Mask,
    limits: Mapping[str, Span] = {},
) -> _Sifted:
    """What may be measured; limits: [SI] of what follows from the readings by closing the loops."""
    gaps = gaps_of(mechanism)
    computed = {*mechanism.outputs, *mechanism.turns, *mechanism.disturbances}
    computed |= {column for o in mechanism.orientations for column in o.columns}
    units = mechanism.units
    bare = {*units} - computed - gaps
    # An empty column, such as that of an unmeasured platform, limits no pose.
    readings = {q: v for q, v in poses.readings.items() if q in bare and not np.isnan(v).all()}
    for q in beyond_freedoms(mechanism, [*readings]):
        del readings[q]
    stated = np.isfinite(np.array([*readings.values()])).all(axis=0)
    readings = {q: np.where(stated, v, 0.0) for q, v in readings.items()}
    readings |= {q: np.zeros(len(poses)) for q in mechanism.disturbances}
    for q, value in mechanism.latest.items():
        readings.setdefault(q, np.full(len(poses), value))
    driven = Dataset.from_arrays(readings, units={q: units[q] for q in readings}, poses=poses.poses)
    closes = stated & reached(mechanism, driven)
    refused = {} if closes.all() else {"loops do not close": int((~closes).sum())}
    if not (touches | ~closes).all():
        refused["does not touch within the limits"] = int((closes & ~touches).sum())
        closes &= touches
    # Before anything is predicted: beside a camera there are no pixels.
    serves, before = shown(mechanism, serves, faces(mechanism, driven))
    if not before.all():
        refused["board not before a camera"] = int((closes & ~before).sum())
        closes &= before
    if not closes.any():
        return _Sifted(len(poses), refused)
    some = np.flatnonzero(closes)
    serves = serves[:, some]
    closed = closed_at(mechanism, driven.take(some), blanks(mechanism, serves))
    serves, whole = shown(mechanism, serves, in_image(mechanism, closed))
    closed = blanked(closed, blanks(mechanism, serves))
    rules = allowed(mechanism, site, closed, whole)
    refused |= rules.refused
    left = rules.poses
    for q, (low, high) in limits.items():
        left = left & (low <= closed.readings[q]) & (closed.readings[q] <= high)
    if limits:
        refused["outside their ranges"] = int((rules.poses & ~left).sum())
    if not left.any():
        return _Sifted(len(poses), refused)
    closed = closed.take(np.flatnonzero(left))
    # Where some poses touch and others do not, their gaps say which.
    mixed = {q for q in gaps if np.isnan(closed.readings[q]).any()}
    hidden = computed | (mechanism.implied.keys() - readings.keys() - mixed)
    shown_quantities = [q for q in closed.readings if q in units and q not in hidden]
    shown_quantities.sort(key=lambda q: q not in readings)
    rows = Dataset.from_arrays(
        {q: closed.readings[q] for q in shown_quantities},
        units={q: units[q] for q in shown_quantities},
        poses=closed.poses,
    )
    return _Sifted(len(poses), refused, rows, closed)


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
    units = mechanism.units
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


# Which candidates may be measured: boxes, the instrument's line of sight, forbidden rows.

Mask = NDArray[np.bool_]
NEAR = {"rad": math.radians(1.0), "m": 1e-3}
"""A candidate is forbidden if every reading is so near to that of a forbidden row [SI]."""


@dataclass(frozen=True, eq=False)
class Allowed:
    """Which candidates (N,) may be measured, and how many each rule takes away."""

    poses: Mask
    refused: Mapping[str, int] = field(default_factory=dict)


def allowed(mechanism: Mechanism, site: PlanSettings, data: Dataset, whole: Mask) -> Allowed:
    """The rules applied to closed candidates, each to what the ones before it left.

    whole: (N,) whether some camera has all of a board in its image. Raises InputError where a rule
    needs a point that the mechanism does not have.
    """
    left = np.ones(len(data), dtype=bool)
    refused: dict[str, int] = {}

    def without(rule: str, bad: Mask) -> None:
        refused[rule] = int((left & bad).sum())
        np.logical_and(left, ~bad, out=left)

    if not whole.all():
        without("board not whole in the image", ~whole)
    if site.forbidden is not None:
        without("forbidden rows", _forbidden(mechanism, site.forbidden, data))
    if site.reach is None and not site.keep_out and site.sight is None:
        return Allowed(left, refused)
    if mechanism.tree is not None and not mechanism.chain:
        return _of_whole_robot(mechanism, site, data, Allowed(left, refused))
    family = _sees_point(mechanism)
    base = _base(mechanism, family)
    measured = np.array([data.readings[q] for q in point_outputs(mechanism, family)])
    read = points(family, measured)
    at = _moved(base, read)
    if site.reach is not None:
        without("reach", ~site.reach.holds(at))
    if site.keep_out:
        chain = _links(mechanism.chain, mechanism, data)
        without("keep-out boxes", _kept_out(site, [*chain, at]))
    if site.sight is not None:
        stands = np.array(site.sight.station)[: len(read), None]
        bad = np.zeros(len(data), dtype=bool)
        for box in site.keep_out:
            bad |= box.crossed(np.broadcast_to(_moved(base, stands), at.shape), at)
        without("line of sight", bad)
        if site.sight.normal is not None:
            angle = _incidence(mechanism, family, data, stands - read, site.sight.normal)
            without("incidence angle", ~(angle <= site.sight.within))
    return Allowed(left, refused)


def _sees_point(mechanism: Mechanism) -> Family:
    for family in mechanism.families:
        if point_outputs(mechanism, family):
            return family
    if not mechanism.families and len(mechanism.outputs) in (2, 3):
        return Family("", (), mechanism.outputs, "point")
    raise InputError(
        f"no instrument of {mechanism.name!r} sees a point",
        code="unsupported",
        remedy="state poses that may not be measured as forbidden rows; leave out reach, keep_out "
        "and sight",
    )


def _base(mechanism: Mechanism, family: Family) -> Array:
    """T_base_readings (4, 4)."""
    station = family.placement or mechanism.placement
    if not isinstance(station, Station):
        return np.eye(4)
    return inverse(product(station.steps, {}, mechanism.parameters.nominal))


def _moved(T: Array, at: Array) -> Array:
    whole = np.zeros((3, at.shape[1]))
    whole[: len(at)] = at
    return np.asarray((T[:3, :3] @ whole + T[:3, 3:])[: len(at)])


def _of_whole_robot(
    mechanism: Mechanism, site: PlanSettings, data: Dataset, so_far: Allowed
) -> Allowed:
    """The boxes for every limb: what a pose serves must be within reach, no link in a box."""
    assert mechanism.tree is not None
    if site.sight is not None:
        raise InputError(
            f"{mechanism.name!r} has several limbs, whose lines of sight are not known",
            code="unsupported",
            remedy="leave out sight; state poses that may not be measured as forbidden rows",
        )
    values = mechanism.parameters.nominal
    left, refused = so_far.poses, dict(so_far.refused)
    outside, hit = (np.zeros(len(data), dtype=bool) for _ in range(2))
    for leaf in mechanism.tree.leaves:
        hit |= _kept_out(site, _links(mechanism.tree.path(leaf), mechanism, data))
    for family in mechanism.families:
        *_, (R, origin) = frames(mechanism.tree.path(family.on), data.readings, values)
        place = [n for n in family.mounted if n.endswith(("_x", "_y", "_z"))][:3]
        on_body = np.array([values[n] for n in place]) if len(place) == 3 else np.zeros(3)
        at = (origin + R @ on_body).T
        served = np.any([np.isfinite(data.readings[q]) for q in family.readings], axis=0)
        hit |= served & _kept_out(site, [origin.T, at])
        if site.reach is not None:
            outside |= served & ~site.reach.holds(at)
    for rule, bad in (("reach", outside), ("keep-out boxes", hit)):
        refused[rule] = int((left & bad).sum())
        left = left & ~bad
    return Allowed(left, refused)


def _kept_out(site: PlanSettings, way: list[Array]) -> Mask:
    """(N,) whether a way through points (d, N) touches a box, or ends in one."""
    bad = np.zeros(way[-1].shape[1], dtype=bool)
    for box in site.keep_out:
        bad |= box.holds(way[-1])
        for a, b in pairwise(way):
            bad |= box.crossed(a, b)
    return bad


def _links(way: Sequence[Step], mechanism: Mechanism, data: Dataset) -> list[Array]:
    """The joints (3, N) of a limb from its base on, and its end; none of other machines."""
    *ahead, (_, tip) = frames(way, data.readings, mechanism.parameters.nominal)
    pairs = zip(way, ahead, strict=True)
    joints = [origin.T for step, (_, origin) in pairs if step.joint is not None]
    return [*joints, tip.T] if joints else []


def _incidence(
    mechanism: Mechanism, family: Family, data: Dataset, away: Array, normal: tuple[float, ...]
) -> Array:
    """(N,) angle between the body's normal and the lines `away` (3, N) to the instrument.

    How the seen point moves with its place on the body is how the body is turned.
    """
    target = target_names(mechanism)
    outputs = point_outputs(mechanism, family)
    if len(target) != len(outputs):
        raise InputError(
            "nothing says how the body is turned where the instrument sees it",
            code="unsupported",
            remedy="leave out sight.normal",
        )
    machine = mechanism.predicting()
    x = np.array([data.readings[q] for q in machine.tape.quantities])
    pose_constants = np.array([data.readings[q] for q in machine.tape.pose_constants]).reshape(
        -1, len(data)
    )
    values = np.array([p.nominal for p in machine.parameters])
    S = output_sensitivity(mechanism, values, target, x, pose_constants).by_parameter
    R = S[:, [mechanism.outputs.index(q) for q in outputs]]
    if family.form in POLAR:
        R = cartesian_slopes(np.array([data.readings[q] for q in outputs])) @ R
    looks = (R @ np.array(normal)[: R.shape[2]]).T
    # R has the columns d(point) / d(place on the body): the rotation matrix of the body.
    cosine = (looks * away).sum(axis=0)
    cosine /= np.linalg.norm(looks, axis=0) * np.linalg.norm(away, axis=0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _forbidden(mechanism: Mechanism, rows: Dataset, data: Dataset) -> Mask:
    units = mechanism.units
    shared = [q for q in rows.readings if q in data.readings and q not in mechanism.outputs]
    near = np.ones((len(data), len(rows)), dtype=bool)
    for q in shared:
        gap = np.abs(data.readings[q][:, None] - rows.readings[q])
        near &= ~(gap > NEAR.get(units[q], 1e-3))
    return np.asarray(near.any(axis=1))
