"""Inclinometers: two axes fixed to body or base, each read as an angle to the horizontal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.expressions.vectors import dot, vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.frame import BodyFrame, ChainFrame, Direction, Frame, Values
from loopcal.mechanisms.instruments.spherical import turn_between
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.station import Name, Station, placed_by

DOWN = {3: (0.0, 0.0, -1.0), 2: (0.0, -1.0, 0.0)}
_BASE = BodyFrame(np.eye(3), np.zeros(3))
Angles = Annotated[
    Sequence[str] | None, Key("Names of the readings. Default: NAME_x, NAME_y; in a plane NAME_x.")
]
Carrier = Annotated[
    str,
    Key(
        'What carries the instrument: the moving "body", the "base", or a body of a tree by its '
        "name."
    ),
]
Gravity = Annotated[
    Sequence[float] | None,
    Key(
        "Nominal direction of gravity in the base, or in the frame of the station. Default: "
        "[0, 0, -1]; in a plane [0, -1, 0].",
        least=3,
        most=3,
    ),
]
Levelled = Annotated[
    str | None,
    Key(
        "Name of a levelled place, such as that of a tracker, in whose frame gravity is exactly as "
        "stated. Default: none; the base is tilted by NAME_tilt_1, NAME_tilt_2."
    ),
]


@recorded
def inclinometer(
    name: Name = "level",
    *,
    readings: Angles = None,
    on: Carrier = "body",
    gravity: Gravity = None,
    station: Levelled = None,
    dimension: int = 3,
) -> Instrument:
    """Angles of two axes, fixed to the body or the base, against the horizontal plane.

    With d = (d_x, d_y, d_z), the direction up seen in the frame of the instrument,

        atan2(d_x, hypot(d_y, d_z)) - NAME_x = 0 [rad]
        atan2(d_y, hypot(d_x, d_z)) - NAME_y = 0 [rad]

    positive where the axis points up. The frame of the instrument lies in what carries it by the
    turns Rz Ry Rx: NAME_rz, NAME_ry, NAME_rx. Up is opposite to gravity, which has a nominal
    direction in the base and two tilts, NAME_tilt_1 and NAME_tilt_2 as for a `plane`; or an exact
    direction in the frame of a station, whose six parameters other instruments determine. In a
    plane the one reading is the angle of the x axis over the horizontal, atan2(d_x, d_y), with the
    one parameter NAME_rz. Where it stands does not matter.

    Raises InputError for a number of readings that does not fit, and a gravity without direction.
    """
    names = tuple(f"{name}_{a}" for a in "xy"[: dimension - 1]) if readings is None else readings
    if len(names) != dimension - 1:
        raise InputError(
            f"the inclinometer {name!r} has {len(names)} readings in a space of {dimension}",
            code="wrong-shape",
            remedy=f"name {dimension - 1}",
        )
    stands = Station(station, dimension)
    down = Direction.near(
        DOWN[dimension] if gravity is None else gravity,
        name=name,
        what="gravity",
        dimension=dimension,
    )
    tilted = station is None and dimension == 3
    turns = ("rz", "ry", "rx")[: 1 if dimension == 2 else 3]
    mounted = tuple(Step(turn, f"{name}_{turn}") for turn in turns)

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        carrier = _BASE if on == "base" else frames[0]
        mounting, placed = ChainFrame(mounted, {}, p), ChainFrame(stands.steps, {}, p)
        pull = down.vector(p) if tilted else vector(*down.axes[0])

        def up(axis: Sequence[float]) -> Any:
            in_base = carrier.direction(mounting.direction(vector(*axis)))
            # up = -gravity, so the component of up along an axis is minus that of the pull.
            return -dot(placed.direction(in_base), pull)

        d = [up(axis) for axis in np.eye(3)[:dimension].tolist()]
        if dimension == 2:
            return [turn_between(d[1], d[0], x[names[0]])]
        level = (np.hypot(d[1], d[2]), np.hypot(d[0], d[2]))
        return [turn_between(level[i], d[i], x[angle]) for i, angle in enumerate(names)]

    return Instrument(
        name,
        dict.fromkeys(names, "rad"),
        placed_by(mounted, name),
        equations,
        "angle",
        placement=down.declared if tilted else stands.declared,
        mounted=tuple(n for s in mounted if on != "base" and (n := s.parameter)),
        place=None if station is None else stands,
        dimension=dimension,
        remedy=f"an axis of {name!r} is vertical, where the other has no direction: give the "
        "turns of its mounting nominal values, and leave out poses that turn it so",
        on=None if on in ("base", "body") else on,
    )
