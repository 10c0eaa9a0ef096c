"""Which candidates may be measured: boxes, the instrument's line of sight, forbidden rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.chain import frames, product
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.outputs import POLAR, cartesian_slopes, point_outputs, points
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.skeleton import target_names
from loopcal.mechanisms.station import Station

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NEAR = {"rad": math.radians(1.0), "m": 1e-3}
"""A candidate is forbidden if every reading is so near to that of a forbidden row [SI]."""


@dataclass(frozen=True, eq=False)
class Allowed:
    """Which candidates (N,) may be measured, and how many each rule takes away."""

    poses: Mask
    refused: Mapping[str, int] = field(default_factory=dict)


def allowed(mechanism: Mechanism, site: PlanSettings, data: Dataset) -> Allowed:
    """The rules applied to closed candidates, each to what the ones before it left.

    Raises InputError where a rule needs a point that the mechanism does not have.
    """
    left = np.ones(len(data), dtype=bool)
    refused: dict[str, int] = {}

    def without(rule: str, bad: Mask) -> None:
        refused[rule] = int((left & bad).sum())
        np.logical_and(left, ~bad, out=left)

    if site.forbidden is not None:
        without("forbidden rows", _forbidden(mechanism, site.forbidden, data))
    if site.reach is None and not site.keep_out and site.sight is None:
        return Allowed(left, refused)
    family = _sees_point(mechanism)
    base = _base(mechanism, family)
    seen = np.array([data.readings[q] for q in point_outputs(mechanism, family)])
    read = points(family, seen)
    at = _moved(base, read)
    if site.reach is not None:
        without("reach", ~site.reach.holds(at))
    if site.keep_out:
        bad = np.zeros(len(data), dtype=bool)
        chain = _links(mechanism, data)
        for box in site.keep_out:
            bad |= box.holds(at)
            for a, b in zip(chain, [*chain[1:], at], strict=False):
                bad |= box.crossed(a, b)
        without("keep-out boxes", bad)
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
    values = {p.name: p.nominal for p in mechanism.parameters}
    return inverse(product(station.steps, {}, values))


def _moved(T: Array, at: Array) -> Array:
    whole = np.zeros((3, at.shape[1]))
    whole[: len(at)] = at
    return np.asarray((T[:3, :3] @ whole + T[:3, 3:])[: len(at)])


def _links(mechanism: Mechanism, data: Dataset) -> list[Array]:
    """The joints (3, N) of a serial arm from its base on; none of other machines."""
    values = {p.name: p.nominal for p in mechanism.parameters}
    *ahead, (_, tip) = frames(mechanism.chain, data.readings, values)
    pairs = zip(mechanism.chain, ahead, strict=True)
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
    units = {**mechanism.quantities, **mechanism.pose_constants}
    shared = [q for q in rows.readings if q in data.readings and q not in mechanism.outputs]
    near = np.ones((len(data), len(rows)), dtype=bool)
    for q in shared:
        gap = np.abs(data.readings[q][:, None] - rows.readings[q])
        near &= ~(gap > NEAR.get(units[q], 1e-3))
    return np.asarray(near.any(axis=1))
