"""The planar 3-RRR: a platform on three arms of two links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.expressions.vectors import vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import BodyFrame, Values
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel import parts
from loopcal.mechanisms.parameters import Gauge

LEGS = (1, 2, 3)
PASSIVE = ("phi_1", "phi_2", "phi_3")
_CORNERS = (210.0, 330.0, 90.0)
Passive = Annotated[
    Sequence[str],
    Key("Passive joints that are read: phi_1, phi_2 and phi_3, the elbows."),
]
# Close to the centred platform, elbows to one side: Newton's method stays on this assembly mode.
_HOME = {"theta_1": 1.42, "theta_2": 3.51, "theta_3": -0.68}
_HOME |= {"platform_x": 0.0, "platform_y": 0.0, "platform_rz": 0.0}
_HOME |= dict.fromkeys(PASSIVE, -1.79)


def three_rrr(
    *,
    passive: Passive = (),
    home: Mapping[str, float] | None = None,
    name: parts.Name = "3-RRR",
) -> Machine:
    """A planar platform on three legs of two links, whose first joints are driven.

    For the legs i = 1 ... 3, with B_i = (platform_x, platform_y) + R(platform_rz) b_i, without a
    sensor of the platform's coordinates,

        |B_i - a_i - proximal_i (cos, sin)(theta_i)| - distal_i = 0 [m],

    theta_i the reading plus theta_i_offset [rad]. passive: elbows "phi_1" ... that carry a sensor
    all the same, with a_i + proximal_i (cos, sin)(theta_i) + distal_i (cos, sin)(theta_i + phi_i)
    - B_i = 0 in place of the length. Parameters [m]: a1_x ... a3_y, b1_x ... b3_y, proximal_1 ...
    distal_3; offsets [rad] of what is read. The example: base joints at 210, 330 and 90 degrees
    on a circle of 0.35 m, platform joints likewise on one of 0.10 m, links of 0.20 m. home: values
    [SI] from which unread quantities are searched.

    Raises InputError for a passive joint or a quantity at home that is not there.
    Source: Gosselin and Angeles (1988).
    """
    passive = parts.chosen_passive(passive, PASSIVE, name)

    def equations(x: Values, p: Values) -> list[Any]:
        body = _platform(x)
        ends = [(i, body.point(parts.joint(p, f"b{i}", 2))) for i in LEGS]
        return [loop for i, end in ends for loop in parts.planar_leg(x, p, i, end, passive)]

    sensed = dict.fromkeys(("theta_1", "theta_2", "theta_3", *passive), "rad")
    quantities = sensed | {"platform_x": "m", "platform_y": "m", "platform_rz": "rad"}
    base, platform = parts.ring(0.35, _CORNERS), parts.ring(0.10, _CORNERS)
    return Machine(
        name,
        quantities,
        parts.joint_coordinates({f"a{i}": base[i - 1] for i in LEGS})
        | parts.joint_coordinates({f"b{i}": platform[i - 1] for i in LEGS})
        | parts.in_unit("m", {f"{link}_{i}": 0.20 for i in LEGS for link in ("proximal", "distal")})
        | parts.offsets(sensed),
        lambda x, p: _platform(x),
        tuple(loop for i in LEGS for loop in parts.planar_leg_names(i, passive)),
        equations,
        home=parts.starts(_HOME, home, quantities, name),
        dimension=2,
        gauge=Gauge(
            base_joints=parts.joint_names("a", 3, "xy"),
            body_joints=parts.joint_names("b", 3, "xy"),
            scaled=True,
        ),
        lines=lines,
        description={"type": "three-rrr", "passive": list(passive), "home": dict(home or {})},
    )


def _platform(x: Values) -> BodyFrame:
    angle = x["platform_rz"]
    origin = vector(x["platform_x"], x["platform_y"], 0.0)
    return parts.plane_frame(np.cos(angle), np.sin(angle), origin)


def lines(x: Values, p: Values) -> parts.Polylines:
    """The legs, and the platform's triangle."""
    body = _platform(x)
    ends = [body.point(parts.joint(p, f"b{i}", 2)) for i in LEGS]
    legs = [[parts.joint(p, f"a{i}", 2), parts.elbow(x, p, i), ends[i - 1]] for i in LEGS]
    return [*legs, [*ends, ends[0]]]
