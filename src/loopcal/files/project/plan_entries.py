"""The [plan] table of a project: among which poses `loopcal plan` chooses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from loopcal.errors import InputError
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.project.verdict_entries import VerdictSpec, one_span, spans
from loopcal.files.toml.place import Place
from loopcal.measurements.plan_settings import Box, PlanSettings, Sight
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import Mechanism

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import BoxEntry, PlanEntry, SightEntry


def plan_settings(
    entry: PlanEntry, mechanism: Mechanism, verdict: VerdictSpec, place: Place
) -> PlanSettings:
    """What a project says of its plans; its working region is where the end point counts.

    Raises InputError for names, units and ranges that do not fit the mechanism.
    """
    units = {**mechanism.quantities, **mechanism.known}
    driven = {q: u for q, u in units.items() if q not in mechanism.outputs}
    stated = spans(entry.ranges, driven, place.at("ranges"))
    limits = joint_limits(mechanism)
    ranges = stated | {q: r for q, r in verdict.region.items() if q not in {*stated, *limits}}
    boxes = [_box(box, place.at("keep_out", str(i))) for i, box in enumerate(entry.keep_out, 1)]
    return PlanSettings(
        ranges,
        verdict.region,
        None if entry.reach is None else _box(entry.reach, place.at("reach")),
        tuple(boxes),
        None if entry.sight is None else _sight(entry.sight, place.at("sight")),
        number=entry.candidates,
        model_error=entry.model_error,
        seed=entry.seed,
    )


def _box(entry: BoxEntry, place: Place) -> Box:
    sides = [
        (-math.inf, math.inf) if side is None else one_span(side, "m", place.at(axis))
        for axis, side in (("x", entry.x), ("y", entry.y), ("z", entry.z))
    ]
    return Box(tuple(s[0] for s in sides), tuple(s[1] for s in sides))


def _sight(entry: SightEntry, place: Place) -> Sight:
    for key, vector in (("station", entry.station), ("normal", entry.normal)):
        if vector is not None and len(vector) != 3:
            raise InputError(
                f"{key} has {len(vector)} numbers",
                code="wrong-shape",
                place=str(place.at(key)),
                remedy="give three numbers: x, y, z",
            )
    if entry.normal is not None and not any(entry.normal):
        raise InputError(
            "the normal is 0, which is no direction",
            code="invalid-value",
            place=str(place.at("normal")),
            remedy="give the direction that the reflector looks along, such as [0, 0, 1]",
        )
    at = place.at("unit")
    station = tuple(in_si(v, entry.unit, "m", at) for v in entry.station)
    normal = None if entry.normal is None else tuple(entry.normal)
    if entry.within is None:
        return Sight(station, normal)
    angle = in_si(entry.within.value, entry.within.unit, "rad", place.at("within", "unit"))
    return Sight(station, normal, angle)
