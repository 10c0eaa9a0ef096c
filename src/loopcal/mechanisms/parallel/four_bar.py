"""The planar four-bar: crank, coupler and rocker between two joints of the base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.expressions.vectors import norm
from loopcal.keys import Key
from loopcal.mechanisms.frame import Frame, Values, Vector
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel import parts
from loopcal.mechanisms.parameters import Gauge

PASSIVE = ("theta_2", "phi_1")
Passive = Annotated[
    Sequence[str],
    Key(
        "Passive joints that are read: theta_2, the angle of the rocker, and phi_1, the angle "
        "of the coupler against the crank."
    ),
]
_HOME = {"theta_1": 1.57, "platform_rz": 0.34, "theta_2": 1.74, "phi_1": -1.23}


def four_bar(
    *,
    passive: Passive = (),
    home: Mapping[str, float] | None = None,
    name: parts.Name = "four-bar",
) -> Machine:
    """A planar four-bar; the moving body is the coupler, its x axis from the crank to the rocker.

    B1 = a1 + crank (cos, sin)(theta_1),  B2 = B1 + coupler (cos, sin)(platform_rz),

        |B2 - a2| - rocker = 0 [m],

    theta_1 the crank's reading plus theta_1_offset [rad], platform_rz the coupler's angle, which
    has no sensor. passive: joints that carry a sensor all the same: "theta_2", the rocker's angle,
    with a2 + rocker (cos, sin)(theta_2) - B2 = 0 in place of its length; "phi_1", the coupler's
    angle against the crank, with platform_rz - theta_1 - phi_1 = 0 [rad]. Parameters [m]: a1_x,
    a1_y, a2_x, a2_y, crank, coupler, rocker; offsets [rad] of what is read. The example: a1 =
    (0, 0), a2 = (0.40, 0), 0.12, 0.38 and 0.25 m, a crank that goes round. home: angles [rad]
    from which unread ones are searched.

    Raises InputError for a passive joint or a quantity at home that is not there.
    Source: Freudenstein (1955).
    """
    passive = parts.chosen_passive(passive, PASSIVE, name)

    def equations(x: Values, p: Values) -> list[Any]:
        _, second = _ends(x, p)
        from_base = second - parts.joint(p, "a2", 2)
        loops = [norm(from_base) - p["rocker"]]
        if "theta_2" in passive:
            loops = list((parts.along(p["rocker"], parts.read(x, p, "theta_2")) - from_base)[:2])
        if "phi_1" in passive:
            loops.append(x["platform_rz"] - parts.read(x, p, "theta_1") - parts.read(x, p, "phi_1"))
        return loops

    def frame(x: Values, p: Values) -> Frame:
        angle = x["platform_rz"]
        return parts.plane_frame(np.cos(angle), np.sin(angle), _ends(x, p)[0])

    angles = dict.fromkeys(("theta_1", "platform_rz", *passive), "rad")
    sensed = {q: unit for q, unit in angles.items() if q != "platform_rz"}
    rocker = ["rocker_x", "rocker_y"] if "theta_2" in passive else ["rocker"]
    return Machine(
        name,
        angles,
        parts.joint_coordinates({"a1": (0.0, 0.0), "a2": (0.40, 0.0)})
        | parts.in_unit("m", {"crank": 0.12, "coupler": 0.38, "rocker": 0.25})
        | parts.offsets(sensed),
        frame,
        (*rocker, *(["phi_1"] if "phi_1" in passive else [])),
        equations,
        home=parts.starts(_HOME, home, angles, name),
        dimension=2,
        gauge=Gauge(base_joints=parts.joint_names("a", 2, "xy"), scaled=True),
        lines=lines,
        description={"type": "four-bar", "passive": list(passive), "home": dict(home or {})},
    )


def _ends(x: Values, p: Values) -> tuple[Vector, Vector]:
    first = parts.joint(p, "a1", 2) + parts.along(p["crank"], parts.read(x, p, "theta_1"))
    return first, first + parts.along(p["coupler"], x["platform_rz"])


def lines(x: Values, p: Values) -> parts.Polylines:
    """Crank, coupler and rocker as one line."""
    return [[parts.joint(p, "a1", 2), *_ends(x, p), parts.joint(p, "a2", 2)]]
