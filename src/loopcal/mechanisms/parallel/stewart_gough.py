"""The Stewart-Gough platform: six legs of changing length between base and platform."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.expressions.vectors import norm, rot_x, rot_y, rot_z, rotate, vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import BodyFrame, Values, Vector
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel import parts
from loopcal.mechanisms.parameters import Gauge

LEGS = (1, 2, 3, 4, 5, 6)
PASSIVE = tuple(f"{angle}_{i}" for i in LEGS for angle in ("alpha", "beta"))
_PLATFORM = dict.fromkeys(("platform_x", "platform_y", "platform_z"), "m")
_PLATFORM |= dict.fromkeys(("platform_rz", "platform_ry", "platform_rx"), "rad")
_BASE_CORNERS = (225.0, 315.0, 345.0, 75.0, 105.0, 195.0)
_PLATFORM_CORNERS = (250.0, 290.0, 10.0, 50.0, 130.0, 170.0)
_OFFSET = 0.55
Passive = Annotated[
    Sequence[str],
    Key("Passive joints that are read: alpha_1, beta_1 and so on, in the base."),
]
_HOME = dict.fromkeys((*_PLATFORM, *PASSIVE), 0.0) | {"platform_z": 0.7}
_HOME |= {f"leg_{i}": 0.2 for i in LEGS}


def stewart_gough(
    *,
    passive: Passive = (),
    home: Mapping[str, float] | None = None,
    name: parts.Name = "Stewart-Gough platform",
) -> Machine:
    """A platform on six legs whose lengths are read; its pose has no sensor.

    For the legs i = 1 ... 6, with P = (platform_x, platform_y, platform_z) and
    R = Rz(platform_rz) Ry(platform_ry) Rx(platform_rx),

        |P + R b_i - a_i| - (leg_i + leg_i_offset) = 0 [m].

    passive: angles of the universal joints in the base that carry a sensor, "alpha_i" about their
    first axis, "beta_i" about the second. The first is the x axis of the joint's frame, which
    stands in the base frame as Rz(joint_i_rz) Ry(joint_i_ry); with w = P + R b_i - a_i seen in it,

        atan2(-w_y, w_z) - alpha_i = 0,   atan2(w_x, hypot(w_y, w_z)) - beta_i = 0 [rad],

    alpha_i and beta_i the readings plus their offsets, so that Rx(alpha) Ry(beta) z is along the
    leg. Parameters [m]: a1_x ... a6_z, b1_x ... b6_z, leg_1_offset ...; [rad] for what is read:
    joint_i_rz, joint_i_ry, alpha_i_offset, beta_i_offset. The example: base joints on a circle of
    0.50 m at 225, 315, 345, 75, 105 and 195 degrees, platform joints on one of 0.30 m at 250, 290,
    10, 50, 130 and 170, legs of 0.55 m and what is read. home: values [SI] from which unread
    quantities are searched.

    Raises InputError for a passive joint or a quantity at home that is not there.
    Source: Wampler, Hollerbach and Arai (1995); the 42 parameters Masory, Wang and Zhuang (1993).
    """
    passive = parts.chosen_passive(passive, PASSIVE, name)

    def equations(x: Values, p: Values) -> list[Any]:
        body = _platform(x)
        legs = [body.point(parts.joint(p, f"b{i}")) - parts.joint(p, f"a{i}") for i in LEGS]
        loops = [norm(w) - parts.read(x, p, f"leg_{i}") for i, w in zip(LEGS, legs, strict=True)]
        return loops + [_turned(p, q, legs[int(q[-1]) - 1]) - parts.read(x, p, q) for q in passive]

    sensed = {f"leg_{i}": "m" for i in LEGS} | dict.fromkeys(passive, "rad")
    quantities = sensed | _PLATFORM
    mounted = dict.fromkeys(q[-1] for q in passive)
    mounts = [f"joint_{i}_{turn}" for i in mounted for turn in ("rz", "ry")]
    base, platform = parts.ring(0.50, _BASE_CORNERS), parts.ring(0.30, _PLATFORM_CORNERS)
    return Machine(
        name,
        quantities,
        parts.joint_coordinates({f"a{i}": (*base[i - 1], 0.0) for i in LEGS})
        | parts.joint_coordinates({f"b{i}": (*platform[i - 1], 0.0) for i in LEGS})
        | parts.offsets(sensed)
        | parts.offsets({f"leg_{i}": "m" for i in LEGS}, _OFFSET)
        | parts.in_unit("rad", dict.fromkeys(mounts, 0.0)),
        lambda x, p: _platform(x),
        (*(f"leg_{i}" for i in LEGS), *passive),
        equations,
        home=parts.starts(_HOME, home, quantities, name),
        gauge=Gauge(base_joints=parts.joint_names("a", 6), body_joints=parts.joint_names("b", 6)),
        lines=lines,
        description={"type": "stewart-gough", "passive": list(passive), "home": dict(home or {})},
    )


def _platform(x: Values) -> BodyFrame:
    R = rot_z(x["platform_rz"]) @ rot_y(x["platform_ry"]) @ rot_x(x["platform_rx"])
    return BodyFrame(R, vector(x["platform_x"], x["platform_y"], x["platform_z"]))


def _turned(p: Values, quantity: str, leg: Vector) -> Any:
    """The angle of a universal joint that a leg (3,) in the base frame makes."""
    kind, i = quantity.split("_")
    # The inverse of Rz Ry: the leg seen in the frame of the universal joint.
    w = rotate("y", -p[f"joint_{i}_ry"], rotate("z", -p[f"joint_{i}_rz"], leg))
    # Rx(alpha) Ry(beta) z = (sin b, -sin a cos b, cos a cos b), solved for a and b.
    if kind == "alpha":
        return np.arctan2(-w[1], w[2])
    return np.arctan2(w[0], np.hypot(w[1], w[2]))


def lines(x: Values, p: Values) -> parts.Polylines:
    """The legs, the base's hexagon and the platform's."""
    body = _platform(x)
    base = [parts.joint(p, f"a{i}") for i in LEGS]
    platform = [body.point(parts.joint(p, f"b{i}")) for i in LEGS]
    legs = [[a, b] for a, b in zip(base, platform, strict=True)]
    return [*legs, [*base, base[0]], [*platform, platform[0]]]
