"""A body whose pose is read, or found: the flange of a robot that says where it is, or a board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from loopcal.arrays import Array
from loopcal.expressions.vectors import vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import BodyFrame, Frame, Values
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parallel.parts import Name, starts
from loopcal.mechanisms.rotations import rotations

POSITION, TURNS = ("x", "y", "z"), ("wx", "wy", "wz")
BEGIN = ("x0", "y0", "z0")
COLUMNS = ("qw", "qx", "qy", "qz")


def free_body(
    *,
    read: Annotated[
        bool,
        Key(
            "Whether somebody reads the pose; else x0, y0, z0 and the quaternion say where the "
            "search for it begins."
        ),
    ] = True,
    home: Mapping[str, float] | None = None,
    name: Name = "free-body",
) -> Machine:
    """A body with six freedoms: T_base_body = (x, y, z), R(qw, qx, qy, qz) Exp(wx, wy, wz).

    x, y, z [m] are read; the orientation is a quaternion of known constants with small turns w
    [rad] about the body's axes, which are read as 0: their sds say how well it is known. There are
    no parameters. A robot that states the pose of its flange is such a body.

    read: False for a body whose pose nobody reads, as a board that is held in front of a camera.
    The known constants then say where the search begins, at (x0 + x, y0 + y, z0 + z), and all six
    quantities have the sd inf. home: where they begin, by default at 0.
    """
    written = Orientation.of("quaternion", None, TURNS)
    constants = dict.fromkeys(COLUMNS, "1")
    begun: Mapping[str, float] = {}
    if not read:
        constants = {**dict.fromkeys(BEGIN, "m"), **constants}
        begun = dict.fromkeys((*POSITION, *TURNS), 0.0)

    def frame(x: Values, p: Values) -> Frame:
        ex, ey, ez = written.axes(x)
        R = np.array([[ex[i], ey[i], ez[i]] for i in range(3)])
        at = [x[c] if read else x[f"{c}0"] + x[c] for c in POSITION]
        turned = _turned(*(x[w] for w in TURNS))
        written_frame = BodyFrame(R, vector(*at))
        columns = [written_frame.direction(turned[:, k]) for k in range(3)]
        return replace(written_frame, rotation=np.stack(columns, axis=1))

    return Machine(
        name,
        {**dict.fromkeys(POSITION, "m"), **dict.fromkeys(TURNS, "rad")},
        {},
        frame,
        pose_constants=constants,
        home=starts(begun, home, (*POSITION, *TURNS), name),
        implied=dict.fromkeys(TURNS, 0.0) if read else {},
        description={"type": "free-body", "read": read, "home": dict(home or {})},
    )


def pose_read(readings: Mapping[str, Array]) -> tuple[Array, Array]:
    """Rotations (N, 3, 3) and places (N, 3) [m] of such a body.

    readings: (N,) each, with the known constants.
    """
    turned = np.moveaxis(_turned(*(readings[w] for w in TURNS)), 2, 0)
    R = rotations(np.stack([readings[c] for c in COLUMNS], axis=-1)) @ turned
    return R, np.stack([readings[c] + readings.get(f"{c}0", 0.0) for c in POSITION], axis=-1)


def _turned(a: Any, b: Any, c: Any) -> Any:
    """Rotation by the vector w = (a, b, c), as Cayley's (I + [w/2]) (I - [w/2])^-1.

    It turns by 2 atan(|w| / 2), which is |w| to the third order, and has no root in it.
    """
    s = 0.25 * (a * a + b * b + c * c)
    scale = 1.0 / (1.0 + s)
    K = ((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0))
    w = (a, b, c)
    rows = [
        [
            scale * ((1.0 - s) * (1.0 if i == j else 0.0) + K[i][j] + 0.5 * w[i] * w[j])
            for j in range(3)
        ]
        for i in range(3)
    ]
    return np.array(rows)
