"""The planar five-bar: two arms of two links that meet in one joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from loopcal.expressions.vectors import vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import Frame, Values
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel import parts
from loopcal.mechanisms.parameters import Gauge

PASSIVE = ("phi_1", "phi_2")
Passive = Annotated[
    Sequence[str],
    Key("Passive joints that are read: phi_1 and phi_2, the elbows."),
]
# Closes for the example's lengths with elbows outwards: searches stay on this assembly mode.
_HOME = {"theta_1": 2.2, "theta_2": 0.94, "phi_1": -1.53, "phi_2": 1.53}
_HOME |= {"platform_x": 0.125, "platform_y": 0.42}


def five_bar(
    *,
    passive: Passive = (),
    home: Mapping[str, float] | None = None,
    name: parts.Name = "five-bar",
) -> Machine:
    """A planar five-bar; the moving body is the distal link of leg 1, its origin where both meet.

    For the legs i = 1, 2, with P = (platform_x, platform_y), without a sensor,

        |P - a_i - proximal_i (cos, sin)(theta_i)| - distal_i = 0 [m],

    theta_i the reading plus theta_i_offset [rad]. passive: elbows that carry a sensor all the same,
    "phi_1", "phi_2", angles of the distal link against the proximal one. Their loop is a_i +
    proximal_i (cos, sin)(theta_i) + distal_i (cos, sin)(theta_i + phi_i) - P = 0. With both read
    the machine calibrates itself, up to its size: then the distance of its base joints is held.
    Parameters [m]: a1_x ... a2_y, proximal_1, distal_1, proximal_2, distal_2; offsets [rad] of what
    is read. The body's x axis goes along the distal link, from the elbow. The example: a1 = (0, 0),
    a2 = (0.25, 0), links of 0.25 and 0.35 m. home: values [SI] from which unread quantities are
    searched.

    Raises InputError for a passive joint or a quantity at home that is not there.
    Source: Wampler, Hollerbach and Arai (1995), whose loop equations name passive joints alike.
    """
    passive = parts.chosen_passive(passive, PASSIVE, name)

    def equations(x: Values, p: Values) -> list[Any]:
        return [loop for i in (1, 2) for loop in parts.planar_leg(x, p, i, _end(x), passive)]

    def frame(x: Values, p: Values) -> Frame:
        end = _end(x)
        direction = (end - parts.elbow(x, p, 1)) / p["distal_1"]
        return parts.plane_frame(direction[0], direction[1], end)

    sensed = dict.fromkeys(("theta_1", "theta_2", *passive), "rad")
    links = {"proximal_1": 0.25, "distal_1": 0.35, "proximal_2": 0.25, "distal_2": 0.35}
    quantities = sensed | {"platform_x": "m", "platform_y": "m"}
    return Machine(
        name,
        quantities,
        parts.joint_coordinates({"a1": (0.0, 0.0), "a2": (0.25, 0.0)})
        | parts.in_unit("m", links)
        | parts.offsets(sensed),
        frame,
        tuple(loop for i in (1, 2) for loop in parts.planar_leg_names(i, passive)),
        equations,
        home=parts.starts(_HOME, home, quantities, name),
        dimension=2,
        gauge=Gauge(base_joints=parts.joint_names("a", 2, "xy"), scaled=True),
        lines=lines,
        description={"type": "five-bar", "passive": list(passive), "home": dict(home or {})},
    )


def _end(x: Values) -> Any:
    return vector(x["platform_x"], x["platform_y"], 0.0)


def lines(x: Values, p: Values) -> parts.Polylines:
    """Both arms as one line."""
    elbows = [parts.elbow(x, p, i) for i in (1, 2)]
    return [[parts.joint(p, "a1", 2), elbows[0], _end(x), elbows[1], parts.joint(p, "a2", 2)]]
