"""Planes that a camera with depth sees: a wall, the floor, a plate that another arm holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.expressions.vectors import dot, vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import ChainFrame, Direction, Frame, Values
from loopcal.mechanisms.instruments.contact import Normal
from loopcal.mechanisms.instruments.spherical import turn_between
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.station import Name, Station

Three = Annotated[
    Sequence[str] | None,
    Key("Names of the two angles and the distance. Default: NAME_tilt_x, NAME_tilt_y, NAME_range."),
]
Plane = Annotated[
    str | None,
    Key("Name of the plane; instruments that see the same one name it alike. Default: NAME_plane."),
]


@recorded
def seen_plane(
    name: Name = "depth",
    *,
    readings: Three = None,
    plane: Plane = None,
    normal: Normal = (0.0, 0.0, 1.0),
) -> Instrument:
    """A camera with depth on the body sees a plane: which way its normal points, and how far it is.

    With T_base_camera = T_base_body T_body_camera, o its place, e_x, e_y, e_z its axes in the base,
    and n . p = PLANE_distance the plane:

        atan2(n . e_x, hypot(n . e_y, n . e_z)) - NAME_tilt_x = 0 [rad]
        atan2(n . e_y, hypot(n . e_x, n . e_z)) - NAME_tilt_y = 0 [rad]
        PLANE_distance - n . o - NAME_range = 0 [m]

    Of a plane a x + b y + c z = d in the frame of the camera, |(a, b, c)| = 1 and d > 0, the
    readings are asin(a), asin(b) and d. The camera sits on the body at NAME_x, NAME_y, NAME_z,
    turned by Rz Ry Rx: NAME_rz, NAME_ry, NAME_rx. normal: nominal direction in the base from the
    camera to the plane; it tilts by PLANE_tilt_1 and PLANE_tilt_2 as for a `plane`. Of a tree the
    plane may ride on any body (`against`).

    Raises InputError for a number of readings that is not three, and a normal without direction.
    """
    usual = [f"{name}_{of}" for of in ("tilt_x", "tilt_y", "range")]
    names = usual if readings is None else [*readings]
    if len(names) != 3:
        raise InputError(
            f"the plane that {name!r} sees has {len(names)} readings",
            code="wrong-shape",
            remedy="name two angles and the distance",
        )
    on = plane or f"{name}_plane"
    across = Direction.near(normal, name=on, what="normal", dimension=3)
    away = f"{on}_distance"
    mounted = Station(name)

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        camera, n = ChainFrame(mounted.steps, {}, p), across.vector(p)
        place = frames[0].point(camera.point(vector(0.0, 0.0, 0.0)))
        axes = [frames[0].direction(camera.direction(vector(*e))) for e in np.eye(3).tolist()]
        d = [dot(n, axis) for axis in axes]
        return [
            turn_between(np.hypot(d[1], d[2]), d[0], x[names[0]]),
            turn_between(np.hypot(d[0], d[2]), d[1], x[names[1]]),
            p[away] - dot(n, place) - x[names[2]],
        ]

    return Instrument(
        name,
        {names[0]: "rad", names[1]: "rad", names[2]: "m"},
        mounted.declared,
        equations,
        "plane",
        placement=across.declared | {away: Parameter(away, 0.0, "m")},
        mounted=mounted.parameters,
        remedy=f"an axis of {name!r} is along the normal of the plane, where the other has no "
        "direction: give its mounting nominal values",
    )
