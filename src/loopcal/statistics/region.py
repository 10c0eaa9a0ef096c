"""Where is a calibration valid? Its stated sd over the working region beside that at its poses.

The working region is a box of joint readings: as the user states it, else the joints' limits. A
turning joint of an arm without limits turns a quarter turn either way of the middle of its readings
at least; what has none of these stays within its readings. A machine of which nothing at all is
known works on the ways between its measured poses: drives of closed loops depend on each other, and
the corners of their box are poses out of use. The sd that `predict` states is averaged (rms)
over random poses of the box, and over the measured ones. A ratio far above 1 says that the data
hold the machine near their own poses only, whatever a cross-validation inside them says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import RegionEntry, RegionRange, RegionSd
from loopcal.document.fit import NoiseEntry, undetected
from loopcal.estimation.cameras.at_board import sight_of
from loopcal.estimation.prediction import predict_outputs, solving
from loopcal.estimation.problem.constants import as_now
from loopcal.estimation.problem.problem import VALUES
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.instruments.camera import before_lens
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import POLAR, OutputGroup, levers, output_groups, point_outputs
from loopcal.statistics.prediction import Parts, parts_at
from loopcal.statistics.predictor import Predictor, trace_sd

# If squares vary by as much as their mean, the rms of 400 is sure to 1 / (2 sqrt(400)) = 2.5 %.
_POSES = 400
# Chosen, not derived: of a six-axis arm one pose in twenty puts a board before a camera.
_TRIED = 16_000
"""Poses of the box among which those are sought that a camera sees."""
# Chosen, not derived: memory of the sweep; more poses hardly change a mean.
_MOST = 2000
# A quarter turn either way (record 0054).
_QUARTER = 0.5 * math.pi
# Chosen, not derived: an rms of 40 is sure to 8 %, by the same formula.
_FEWEST = 40
"""Poses of the box that the machine can reach; of fewer nothing is said."""
# Chosen, not derived: images are larger than what corners fill. Record 0147.
_BEYOND = 0.5
"""How much farther than corners reach a camera sees, as a share of that, in a region of joints."""
# Chosen, not derived: more than an encoder's noise, far less than shows anything of a joint.
_STILL = 1e-3
"""A joint that covers less of its region stood still."""
# Each part costs a call, and two blocks of this size take no more memory than the fit.
_PARTS = 2
"""Blocks of values of which the covariances of one part are made."""
Span = tuple[float, float]


def region_of(
    result: FitResult, calibrated: Predictor, stated: Mapping[str, Span] | None = None
) -> RegionEntry | None:
    """The working region and the sds there; None where the machine cannot be moved in a box.

    stated: quantity -> range [SI], in place of limits.
    """
    stated = stated or {}
    region = _region(result, calibrated, stated)
    if region is None:
        return None
    names, readings = calibrated.mechanism.tape.quantities, result.problem.readings
    stood: dict[str, Span] = {}
    for one in region.ranges:
        row = readings[names.index(one.quantity)]
        moves = one.source == "readings" or np.ptp(row) >= _STILL * (one.high - one.low)
        if one.quantity not in stated and not moves:
            stood[one.quantity] = float(row.min()), float(row.max())
    if not stood:
        return region
    still = _region(result, calibrated, {**stated, **stood})
    return replace(region, parked=tuple(stood), while_parked=still.by if still else ())


def _region(
    result: FitResult, calibrated: Predictor, stated: Mapping[str, Span]
) -> RegionEntry | None:
    mechanism = calibrated.mechanism
    machine, problem = mechanism.predicting(), result.problem
    names, outputs = machine.tape.quantities, set(machine.outputs)
    corrected = problem.readings + result.solution.corrections
    unread = [bool(np.isinf(sd).all()) for sd in problem.uncertainty.sd]
    still = (*machine.disturbances, *machine.unused)
    driven = [
        q for i, q in enumerate(names) if q not in outputs and q not in still and not unread[i]
    ]
    if not driven:
        return None
    ranges = ranges_of(mechanism, {q: corrected[names.index(q)] for q in driven}, stated)
    now = as_now(mechanism, problem.pose_constants)
    also = [q for i, q in enumerate(names) if unread[i] and q not in still]
    between = driven if {one.source for one in ranges} == {"readings"} else []
    groups = _groups(mechanism)
    cameras = all(group.image for group in groups)
    count, beyond = _TRIED if cameras else _POSES, 0.0 if between else _BEYOND
    x, constants = _random_poses(calibrated, ranges, count, corrected, now, between)
    if cameras:
        solved = solving(mechanism, also)
        values = np.array([p.nominal for p in solved.parameters])
        now_at = np.nan_to_num(x), constants
        pixels = predict_outputs(solved, values, *now_at, calibrated.names)
        views = [_in_view(corrected, names, group, pixels, beyond) for group in groups]
        views = [
            view & _before(mechanism, group, x, constants)
            for view, group in zip(views, groups, strict=True)
        ]
        seen = np.any(views, axis=0)
        kept = np.flatnonzero(seen)[:_POSES]
        if len(kept) < _FEWEST:
            return None
        x, constants = x[:, kept], constants[:, kept]
    some = slice(None, None, max(1, -(-problem.count // _MOST)))
    _, of_fit = _sds(calibrated, groups, corrected[:, some], now[:, some], also, measured=True)
    predicted, of_region = _sds(calibrated, groups, x, constants, also)
    of_bounds: list[dict[str, Array]] = [{}] * len(groups)
    if bounds := bounds_of(result.noise):
        sds = {**calibrated.readings.sds, **bounds}
        bounded = replace(calibrated, readings=replace(calibrated.readings, sds=sds))
        of_bounds = _sds(bounded, groups, corrected[:, some], now[:, some], also, measured=True)[1]
    read = np.isfinite(np.broadcast_to(problem.uncertainty.sd, corrected.shape))[:, some]
    worst: dict[str, tuple[float, RegionSd]] = {}
    for group, at_poses, over_region, at_bounds in zip(
        groups, of_fit, of_region, of_bounds, strict=True
    ):
        out = group.image and ~(
            _in_view(corrected, names, group, predicted, beyond)
            & _before(mechanism, group, x, constants)
        )
        # Of poses in which an instrument read nothing, no data say how sure it is there.
        seen = read[[names.index(q) for q in group.outputs]].any(axis=0)
        for unit, at in at_poses.items():
            at, over = np.where(seen, at, np.nan), np.where(out, np.nan, over_region[unit])
            ratio, sd = _ratio(unit, at[np.isfinite(at)], over[~np.isnan(over)])
            if sd is not None and ratio >= worst.get(unit, (0.0, None))[0]:
                of = group.instrument if len({one.instrument for one in groups}) > 1 else None
                bound = _rms(at_bounds[unit][seen]) if at_bounds else None
                worst[unit] = ratio, replace(sd, instrument=of, sd_at_bounds=bound)
    by = sorted(worst.values(), key=lambda one: -one[0])
    return RegionEntry(tuple(ranges), tuple(one for _, one in by)) if by else None


def _random_poses(
    calibrated: Predictor,
    ranges: Sequence[RegionRange],
    count: int,
    corrected: Array,
    now: Array,
    between: Sequence[str],
) -> tuple[Array, Array]:
    """Readings (k, N) and constants (c, N) of random poses of the box, or on the ways between
    those measured, corrected (k, M), of these readings; now: the constants (c, M) there."""
    names = calibrated.mechanism.tape.quantities
    # A fixed seed: the same result has the same region.
    rng = np.random.default_rng(0)
    x = _poses_in(calibrated, ranges, rng, count)
    if between:
        rows = [names.index(q) for q in between]
        first, last = rng.integers(0, corrected.shape[1], (2, count))
        x[rows] = corrected[rows][:, first]
        # One share for all joints: a point on the straight way between two poses.
        x[rows] += rng.random(count) * (corrected[rows][:, last] - x[rows])
    return x, now[:, rng.integers(0, now.shape[1] or 1, count)]


def _ratio(unit: str, at: Array, over: Array) -> tuple[float, RegionSd | None]:
    """Of the sds over the region to those at the poses of the fit; no sd where poses are few."""
    if not at.size or len(over) < _FEWEST:
        return 0.0, None
    mean, far = _rms(at), float(np.sqrt(np.square(over).mean()))
    ratio = far / mean if mean else np.inf
    finite = (far, ratio) if np.isfinite(far) and np.isfinite(ratio) else (None, None)
    return ratio, RegionSd(unit, mean, *finite)


def _rms(sds: Array) -> float:
    return float(np.sqrt(np.square(sds[~np.isnan(sds)]).mean()))


def bounds_of(noise: Sequence[NoiseEntry]) -> dict[str, float]:
    """Upper bounds of the sds of readings that may be 0; none where one has no bound."""
    bounds = {q: e.upper for e in undetected(noise) for q in e.quantities}
    return {} if None in bounds.values() else {q: b for q, b in bounds.items() if b is not None}


def _sds(
    calibrated: Predictor,
    groups: Sequence[OutputGroup],
    x: Array,
    constants: Array,
    also: list[str],
    *,
    measured: bool = False,
) -> tuple[Array, list[dict[str, Array]]]:
    """Outputs (o, N) at readings x (k, N), and of each group unit -> sd (N,); of images by m too.

    In parts, because covariances of images are large.
    """
    size = max(1, _PARTS * VALUES // len(calibrated.units) ** 2)
    outputs, sds = [], []
    for begin in range(0, x.shape[1], size):
        part = slice(begin, begin + size)
        at = x[:, part], constants[:, part]
        parts = _parts(calibrated, *at, also, measured)
        outputs.append(parts.outputs)
        sds.append([_by_unit(calibrated, group, *at, parts) for group in groups])
    joined = [
        {unit: np.concatenate([one[i][unit] for one in sds]) for unit in sds[0][i]}
        for i in range(len(groups))
    ]
    return np.concatenate(outputs, axis=1), joined


def _groups(mechanism: Mechanism) -> list[OutputGroup]:
    """The outputs whose sds belong together; range and angles of one point are its place [m]."""
    families = {family.name: family for family in mechanism.families if family.form in POLAR}
    groups = []
    for group in output_groups(mechanism):
        family = families.get(group.instrument)
        if family is not None and set(family.readings) <= set(mechanism.outputs):
            if group.unit != "m":
                continue
            outputs = point_outputs(mechanism, family)
            rows = tuple(mechanism.outputs.index(q) for q in outputs)
            group = replace(group, outputs=outputs, rows=rows)
        groups.append(group)
    return groups


def _by_unit(
    calibrated: Predictor, group: OutputGroup, x: Array, constants: Array, parts: Parts
) -> dict[str, Array]:
    mechanism, covariance = calibrated.mechanism, parts.covariance
    if group.image:
        at_board = _at_board(calibrated, group, x, constants, covariance)
        return {group.unit: trace_sd(covariance, group), "m": at_board}
    family = next((one for one in mechanism.families if one.name == group.instrument), None)
    if family is not None and len(group.outputs) == len(family.readings):
        rows = list(group.rows)
        covariance = covariance.copy()
        arms = levers(family, parts.outputs[rows]).T  # (N, r) [m] per reading
        covariance[:, rows, rows] *= np.square(arms)
    return {group.unit: trace_sd(covariance, group)}


def _at_board(
    calibrated: Predictor, group: OutputGroup, x: Array, constants: Array, covariance: Array
) -> Array:
    """(N,) sd [m] of the board that a camera sees at readings x (k, N)."""
    mechanism = calibrated.mechanism
    values = np.array([p.nominal for p in mechanism.parameters])
    sight = sight_of(mechanism, group.instrument, values, np.nan_to_num(x), constants)
    o = len(mechanism.outputs)
    return replace(sight, slopes=sight.slopes[:, :, :o]).sds(covariance)


def _in_view(
    readings: Array, names: Sequence[str], group: OutputGroup, outputs: Array, beyond: float
) -> NDArray[np.bool_]:
    """(N,) the poses of a region that put a whole board where a camera sees it.

    readings (k, M): with the pixels at the poses of the fit, in the order of names; outputs (o, N):
    with those of the region. A camera sees as far as corners reach, across, down and from their
    middle, and this share of it farther on each side.
    """
    u, v = (readings[[names.index(q) for q in group.outputs[axis::2]]] for axis in (0, 1))
    ends = [(np.nanmin(read), np.nanmax(read)) for read in (u, v)]
    middle = [0.5 * (low + high) for low, high in ends]
    half = [0.5 * (high - low) for low, high in ends]
    off = [outputs[list(group.rows[axis::2])] - middle[axis] for axis in (0, 1)]
    # Lenses bend by the radius: in the corners of an image none may have been seen.
    farthest = np.nanmax(np.hypot(u - middle[0], v - middle[1]))
    reach = 1.0 + 2.0 * beyond
    inside = np.hypot(*off) <= reach * farthest
    for axis in (0, 1):
        inside &= np.abs(off[axis]) <= reach * half[axis]
    return np.asarray(inside.all(axis=0))


def _before(
    mechanism: Mechanism, group: OutputGroup, x: Array, constants: Array
) -> NDArray[np.bool_]:
    """(N,) the poses (k, N) of a region in which a board is before the lens of a camera."""
    family = next(one for one in mechanism.families if one.name == group.instrument)
    readings = dict(zip(mechanism.tape.quantities, np.nan_to_num(x), strict=True))
    readings |= dict(zip(mechanism.pose_constants, constants, strict=True))
    return before_lens(mechanism, family, readings, x.shape[1])


def ranges_of(
    mechanism: Mechanism, readings: Mapping[str, Array], stated: Mapping[str, Span]
) -> list[RegionRange]:
    """The box of the working region; readings: (N,) [SI] of what drives the machine, NaN: none."""
    limits = joint_limits(mechanism)
    turning = {q for q, unit in mechanism.joints.items() if unit == "rad"}
    ranges = []
    for q, row in readings.items():
        if q in stated:
            ranges.append(RegionRange(q, *stated[q], "stated"))
        elif q in limits:
            ranges.append(RegionRange(q, limits[q].low, limits[q].high, "limits"))
        else:
            low, high = float(np.nanmin(row)), float(np.nanmax(row))
            if q in turning:
                middle = 0.5 * (low + high)
                low, high = min(low, middle - _QUARTER), max(high, middle + _QUARTER)
            ranges.append(RegionRange(q, low, high, "turn" if q in turning else "readings"))
    return ranges


def _poses_in(
    calibrated: Predictor, ranges: Sequence[RegionRange], rng: np.random.Generator, count: int
) -> Array:
    """(k, N) random readings [SI] of the box, what it does not hold as is typical."""
    names = calibrated.mechanism.tape.quantities
    home = np.array([calibrated.typical.get(q, 0.0) for q in names])
    x = np.repeat(home[:, None], count, axis=1)
    for one in ranges:
        x[names.index(one.quantity)] = rng.uniform(one.low, one.high, count)
    return x


def sds_in(
    calibrated: Predictor, ranges: Sequence[RegionRange], constants: Mapping[str, float]
) -> list[float]:
    """By group of outputs, the sd that the parameters cause: rms over random poses of a box.

    constants: those of each pose [SI], such as a temperature.
    """
    x = _poses_in(calibrated, ranges, np.random.default_rng(0), _POSES)
    values = [constants[name] for name in calibrated.mechanism.tape.pose_constants]
    rows = np.repeat(np.reshape(values, (-1, 1)), _POSES, axis=1)
    covariance = _parts(calibrated, x, rows, []).from_parameters
    sds = [trace_sd(covariance, group) for group in output_groups(calibrated.mechanism)]
    sds = [sd[~np.isnan(sd)] for sd in sds]
    return [float(np.sqrt(np.square(sd).mean())) if len(sd) >= _FEWEST else 0.0 for sd in sds]


def _parts(
    calibrated: Predictor, x: Array, constants: Array, also: list[str], measured: bool = False
) -> Parts:
    """What is stated at readings x (k, N) [SI]; NaN where loops stay open.

    also: what no sensor reads: the loops find it with the outputs; measured: at poses of the fit.
    """
    tape = calibrated.mechanism.tape
    columns = dict(zip(tape.quantities, np.nan_to_num(x), strict=True))
    columns |= dict(zip(tape.pose_constants, constants, strict=True))
    return parts_at(calibrated, Dataset.from_arrays(columns), also, measured=measured)
