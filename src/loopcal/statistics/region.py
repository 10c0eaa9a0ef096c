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

import numpy as np
from numpy.typing import NDArray

from loopcal.document.findings import RegionEntry, RegionRange, RegionSd
from loopcal.estimation.problem.constants import as_now
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import output_groups
from loopcal.statistics.prediction import Parts, parts_at
from loopcal.statistics.predictor import Predictor, trace_sd

Array = NDArray[np.float64]
# If squares vary by as much as their mean, the rms of 400 is sure to 1 / (2 sqrt(400)) = 2.5 %.
_POSES = 400
# Chosen, not derived: memory of the sweep; more poses hardly change a mean.
_MOST = 2000
# A quarter turn either way (record 0054).
_QUARTER = 0.5 * math.pi
# Chosen, not derived: an rms of 40 is sure to 8 %, by the same formula.
_FEWEST = 40
"""Poses of the box that the machine can reach; of fewer nothing is said."""
Span = tuple[float, float]


def region_of(
    result: FitResult, calibrated: Predictor, stated: Mapping[str, Span] | None = None
) -> RegionEntry | None:
    """The working region and the sds there; None where the machine cannot be moved in a box.

    stated: quantity -> range [SI], in place of limits.
    """
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
    ranges = ranges_of(mechanism, {q: corrected[names.index(q)] for q in driven}, stated or {})
    # A fixed seed: the same result has the same region.
    rng = np.random.default_rng(0)
    x = _poses_in(calibrated, ranges, rng)
    if {one.source for one in ranges} == {"readings"}:
        rows = [names.index(q) for q in driven]
        first, last = rng.integers(0, problem.count, (2, _POSES))
        x[rows] = corrected[rows][:, first]
        # One share for all joints: a point on the straight way between two poses.
        x[rows] += rng.random(_POSES) * (corrected[rows][:, last] - x[rows])
    now = as_now(mechanism, problem.pose_constants)
    constants = now[:, rng.integers(0, now.shape[1] or 1, _POSES)]
    also = [q for i, q in enumerate(names) if unread[i] and q not in still]
    region = _parts(calibrated, x, constants, also)
    some = slice(None, None, max(1, -(-problem.count // _MOST)))
    fit = _parts(calibrated, corrected[:, some], now[:, some], also, True)
    worst: dict[str, tuple[float, RegionSd]] = {}
    for group in output_groups(mechanism):
        at, over = (trace_sd(parts.covariance, group) for parts in (fit, region))
        if group.points > 1:
            rows = [names.index(q) for q in group.outputs]
            over[~_in_view(corrected[rows], region.outputs[list(group.rows)])] = np.nan
        at, over = at[np.isfinite(at)], over[~np.isnan(over)]
        if not at.size or len(over) < _FEWEST:
            continue
        mean, far = (float(np.sqrt(np.square(v).mean())) for v in (at, over))
        ratio = far / mean if mean else np.inf
        finite = (far, ratio) if np.isfinite(far) and np.isfinite(ratio) else (None, None)
        if ratio >= worst.get(group.unit, (0.0, None))[0]:
            worst[group.unit] = ratio, RegionSd(group.unit, mean, *finite)
    by = sorted(worst.values(), key=lambda one: -one[0])
    return RegionEntry(tuple(ranges), tuple(one for _, one in by)) if by else None


def _in_view(seen: Array, predicted: Array) -> NDArray[np.bool_]:
    """(N,) the poses of a region that put the middle of a board where a camera sees it.

    seen, predicted: pixels u, v of its points in turn (2 points, N). A camera sees as far as
    corners reach, and half of that farther on each side.
    """
    inside = np.ones(predicted.shape[1], dtype=bool)
    for axis in (0, 1):
        low, high = np.nanmin(seen[axis::2]), np.nanmax(seen[axis::2])
        middle, half = 0.5 * (low + high), high - low
        inside &= np.abs(np.median(predicted[axis::2], axis=0) - middle) <= half
    return inside


def ranges_of(
    mechanism: Mechanism, readings: Mapping[str, Array], stated: Mapping[str, Span]
) -> list[RegionRange]:
    """The box of the working region; readings: (N,) [SI] of what drives the machine."""
    limits = joint_limits(mechanism)
    turning = {q for q, unit in mechanism.joints.items() if unit == "rad"}
    ranges = []
    for q, row in readings.items():
        if q in stated:
            ranges.append(RegionRange(q, *stated[q], "stated"))
        elif q in limits:
            ranges.append(RegionRange(q, limits[q].low, limits[q].high, "limits"))
        else:
            low, high = float(row.min()), float(row.max())
            if q in turning:
                middle = 0.5 * (low + high)
                low, high = min(low, middle - _QUARTER), max(high, middle + _QUARTER)
            ranges.append(RegionRange(q, low, high, "turn" if q in turning else "readings"))
    return ranges


def _poses_in(
    calibrated: Predictor, ranges: Sequence[RegionRange], rng: np.random.Generator
) -> Array:
    """(k, N) random readings [SI] of the box, what it does not hold as is typical."""
    names = calibrated.mechanism.tape.quantities
    home = np.array([calibrated.typical.get(q, 0.0) for q in names])
    x = np.repeat(home[:, None], _POSES, axis=1)
    for one in ranges:
        x[names.index(one.quantity)] = rng.uniform(one.low, one.high, _POSES)
    return x


def sds_in(
    calibrated: Predictor, ranges: Sequence[RegionRange], constants: Mapping[str, float]
) -> list[float]:
    """By group of outputs, the sd that the parameters cause: rms over random poses of a box.

    constants: those of each pose [SI], such as a temperature.
    """
    x = _poses_in(calibrated, ranges, np.random.default_rng(0))
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
