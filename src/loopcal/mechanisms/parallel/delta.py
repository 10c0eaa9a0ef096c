"""Delta robots: three legs carry a platform that never turns, from carriages or swinging arms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from loopcal.expressions.vectors import norm, rotate, vector
from loopcal.mechanisms.frame import BodyFrame, Values, Vector
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel import parts
from loopcal.mechanisms.parameters import Gauge

LEGS = (1, 2, 3)
SLIDES = {f"slide_{i}": "m" for i in LEGS}
ARMS = {f"theta_{i}": "rad" for i in LEGS}
_PLATFORM = dict.fromkeys(("platform_x", "platform_y", "platform_z"), "m")
_AZIMUTHS = (210.0, 330.0, 90.0)
"""Of the legs of both examples [deg]."""
_CENTRED = {"platform_x": 0.0, "platform_y": 0.0}
_LINEAR_HOME = dict.fromkeys(SLIDES, 0.4) | _CENTRED | {"platform_z": 0.135}
_ROTARY_HOME = dict.fromkeys(ARMS, 0.5) | _CENTRED | {"platform_z": -0.41}


def linear_delta(
    *, home: Mapping[str, float] | None = None, name: parts.Name = "linear delta"
) -> Machine:
    """A delta whose platform hangs from three carriages on rails; it moves without turning.

    For the legs i = 1 ... 3, with P = (platform_x, platform_y, platform_z), without a sensor,

        u_i = Ry(rail_i_ry) Rx(rail_i_rx) z,   |P - (a_i + slide_i u_i)| - rod_i = 0 [m],

    slide_i the reading plus slide_i_offset [m], a_i = (a_i_x, a_i_y, 0) where the rail's line
    meets the plane z = 0. The two rods of a leg are taken as parallel and equal; where they meet
    platform and carriage is contained in a_i, since a platform that never turns shows only the
    difference of both. Parameters [m]: a1_x ... a3_y, rod_1 ..., slide_1_offset ...; [rad]:
    rail_1_rx ... rail_3_ry. The example: rails at 210, 330 and 90 degrees on a circle of 0.14 m,
    rods of 0.30 m, carriages above the platform. home: values [m] from which unread quantities
    are searched; with carriages below give a larger platform_z.

    Raises InputError for a quantity at home that is not there.
    Source: Clavel (1988); Vischer and Clavel (1998), for the errors that its geometry may have.
    """

    def equations(x: Values, p: Values) -> list[Any]:
        return [norm(_point(x) - _carriage(x, p, i)) - p[f"rod_{i}"] for i in LEGS]

    feet = parts.ring(0.14, _AZIMUTHS)
    quantities = SLIDES | _PLATFORM
    tilts = [f"rail_{i}_{turn}" for i in LEGS for turn in ("rx", "ry")]
    return Machine(
        name,
        quantities,
        parts.joint_coordinates({f"a{i}": feet[i - 1] for i in LEGS})
        | parts.in_unit("rad", dict.fromkeys(tilts, 0.0))
        | parts.in_unit("m", {f"rod_{i}": 0.30 for i in LEGS})
        | parts.offsets(SLIDES),
        lambda x, p: BodyFrame(np.eye(3), _point(x)),
        tuple(f"leg_{i}" for i in LEGS),
        equations,
        home=parts.starts(_LINEAR_HOME, home, quantities, name),
        gauge=Gauge(
            base=("rail_1_rx", "rail_1_ry", "slide_1_offset"),
            base_joints=parts.joint_names("a", 3, "xy"),
            translating=True,
        ),
        lines=_rails,
        description={"type": "linear-delta", "home": dict(home or {})},
    )


def rotary_delta(
    *, home: Mapping[str, float] | None = None, name: parts.Name = "rotary delta"
) -> Machine:
    """A delta whose platform hangs from three arms that swing; it moves without turning.

    For the legs i = 1 ... 3, with P = (platform_x, platform_y, platform_z), without a sensor,

        K_i = a_i + Rz(azimuth_i) Rx(tilt_i) Ry(theta_i) (proximal_i, 0, 0)^T,
        |P - K_i| - distal_i = 0 [m],

    theta_i the reading plus theta_i_offset [rad], positive downwards. The two rods of a leg are
    taken as parallel and equal; where they meet the platform is contained in a_i, since a platform
    that never turns shows only the difference of both. Parameters [m]: a1_x ... a3_z, proximal_1,
    distal_1 ...; [rad]: azimuth_1, tilt_1, theta_1_offset .... The example: arms at 210, 330 and
    90 degrees, a_i on a circle of 0.15 m (the base's less the platform's), arms of 0.20 m, rods of
    0.45 m. home: values [SI] from which unread quantities are searched.

    Raises InputError for a quantity at home that is not there.
    Source: Clavel (1988); Vischer and Clavel (1998), for the errors that its geometry may have.
    """

    def equations(x: Values, p: Values) -> list[Any]:
        return [norm(_point(x) - _knee(x, p, i)) - p[f"distal_{i}"] for i in LEGS]

    shoulders = parts.ring(0.15, _AZIMUTHS)
    quantities = ARMS | _PLATFORM
    azimuths = {f"azimuth_{i}": math.radians(_AZIMUTHS[i - 1]) for i in LEGS}
    return Machine(
        name,
        quantities,
        parts.joint_coordinates({f"a{i}": (*shoulders[i - 1], 0.0) for i in LEGS})
        | parts.in_unit("rad", azimuths | {f"tilt_{i}": 0.0 for i in LEGS})
        | parts.in_unit("m", {f"proximal_{i}": 0.20 for i in LEGS})
        | parts.in_unit("m", {f"distal_{i}": 0.45 for i in LEGS})
        | parts.offsets(ARMS),
        lambda x, p: BodyFrame(np.eye(3), _point(x)),
        tuple(f"leg_{i}" for i in LEGS),
        equations,
        home=parts.starts(_ROTARY_HOME, home, quantities, name),
        gauge=Gauge(
            base=("a1_x", "a1_y", "a1_z", "azimuth_1", "tilt_1", "theta_1_offset"),
            translating=True,
        ),
        lines=_arms,
        description={"type": "rotary-delta", "home": dict(home or {})},
    )


def _point(x: Values) -> Vector:
    return vector(x["platform_x"], x["platform_y"], x["platform_z"])


def _carriage(x: Values, p: Values, i: int) -> Vector:
    up = vector(0.0, 0.0, parts.read(x, p, f"slide_{i}"))
    turned = rotate("y", p[f"rail_{i}_ry"], rotate("x", p[f"rail_{i}_rx"], up))
    carriage: Vector = parts.joint(p, f"a{i}", 2) + turned
    return carriage


def _rails(x: Values, p: Values) -> parts.Polylines:
    """Every rail up to its carriage, and the rod to the platform."""
    return [[parts.joint(p, f"a{i}", 2), _carriage(x, p, i), _point(x)] for i in LEGS]


def _knee(x: Values, p: Values, i: int) -> Vector:
    arm = rotate("y", parts.read(x, p, f"theta_{i}"), vector(p[f"proximal_{i}"], 0.0, 0.0))
    turned = rotate("z", p[f"azimuth_{i}"], rotate("x", p[f"tilt_{i}"], arm))
    knee: Vector = parts.joint(p, f"a{i}") + turned
    return knee


def _arms(x: Values, p: Values) -> parts.Polylines:
    """Every arm and its rod, from the base to the platform."""
    return [[parts.joint(p, f"a{i}"), _knee(x, p, i), _point(x)] for i in LEGS]
