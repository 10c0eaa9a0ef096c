"""A full pose of the body: a point and how the body is turned, as probes and cameras give them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.expressions.vectors import cross, vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.frame import ChainFrame, Frame, Values
from loopcal.mechanisms.instruments.orientation import Orientation, small_turns
from loopcal.mechanisms.instruments.point import Coordinates, point
from loopcal.mechanisms.instruments.spherical import turn_between
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.station import Name, StandsAt, Station, Target, placed_by

Turns = Annotated[
    Sequence[str] | None,
    Key(
        "Names of the small turns between measured and predicted orientation, which are read as 0 "
        "and have the angular noise as sd. Default: NAME_wx, NAME_wy, NAME_wz. In a plane the name "
        "of the one angle that is read. Default: NAME_phi."
    ),
]
Form = Annotated[
    str,
    Key(
        'How the orientation is written: "quaternion" with w first, "rotation-vector", or three '
        'turns about moving axes such as "rz ry rx" for Rz Ry Rx.'
    ),
]
Columns = Annotated[
    Sequence[str] | None,
    Key(
        "Names of the numbers of the orientation, which are known constants of each pose. Default: "
        "qw, qx, qy, qz; or rvx, rvy, rvz; or the turns."
    ),
]
Framed = Annotated[
    str | Target,
    Key(
        "Name of the frame on the body: six parameters TARGET_x, _y, _z, _rz, _ry, _rx. An empty "
        "list stands for the frame of the body itself."
    ),
]


@recorded
def pose(
    name: Name = "pose",
    *,
    readings: Coordinates = None,
    turns: Turns = None,
    orientation: Form = "quaternion",
    columns: Columns = None,
    station: StandsAt = "base",
    target: Framed = "tool",
    dimension: int = 3,
) -> Instrument:
    """Position and orientation of a frame fixed to the body, seen from a station.

    Position: as `point`. Orientation: the measured one is a constant of each pose, R_meas. Three
    small turns w say how far it is off; they are read as 0 with the angular noise for sd:

        2 tan(theta/2) u - w = 0 [rad],   R_meas^T R_pred = rotation by theta about u,

    that is 2 vee(M - M^T) / (1 + tr M) with M = R_meas^T R_pred: theta u to the third order, in
    the measured frame. It is zero nowhere else, unlike vee(M - M^T) / 2, which is zero at half a
    turn too. R_pred = R_station_base R_base_body R_body_target.

    turns: names of w, by default NAME_wx, NAME_wy, NAME_wz; orientation: how the measured one is
    written: "quaternion" (of any length but zero); "rotation-vector" (axis times angle); or three
    turns about moving axes, as "rz ry rx" for Rz Ry Rx; columns: names of its numbers, by default
    qw, qx, qy, qz, or rvx, rvy, rvz, or those of the turns. target: name of the frame, which lies
    in the body by six parameters TARGET_x, _y, _z and TARGET_rz, _ry, _rx (Rz Ry Rx). An empty
    `Target` is the body's own frame. In a plane x, y and one angle NAME_phi, a reading like
    others, and TARGET_x, _y, _rz.

    Raises InputError for numbers of names that do not fit.
    """
    position = point(name, readings=readings, station=station, target=target, dimension=dimension)
    if len(position.readings) != dimension:
        raise InputError(
            f"the instrument {name!r} reads an orientation, and {len(position.readings)} "
            f"coordinates in a space of {dimension}",
            code="wrong-shape",
            remedy=f"name {dimension} coordinates",
        )
    suffixes = ("phi",) if dimension == 2 else ("wx", "wy", "wz")
    angles = tuple(f"{name}_{s}" for s in suffixes) if turns is None else tuple(turns)
    if len(angles) != len(suffixes):
        raise InputError(
            f"the instrument {name!r} has {len(angles)} turns in a space of {dimension}",
            code="wrong-shape",
            remedy=f"name {len(suffixes)}",
        )
    if dimension == 2 and (columns is not None or orientation != "quaternion"):
        raise InputError(
            f"the instrument {name!r} states a spatial orientation, but the machine is planar",
            code="unsupported",
            remedy=f"remove it; the reading is one angle, {angles[0]}",
        )
    if not isinstance(target, str) and target.parameters:
        raise InputError(
            f"the target of {name!r} has no name for its turns",
            code="missing-key",
            remedy="give the target a name",
        )
    measured = Orientation.of(orientation, columns, angles) if dimension == 3 else None
    stands = Station(station, dimension)
    motions = ("rz", "ry", "rx")[: 1 if dimension == 2 else 3] if isinstance(target, str) else ()
    turn_names = [f"{target}_{motion}" for motion in motions]
    steps = tuple(Step(m, n) for m, n in zip(motions, turn_names, strict=True))

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        seen, fixed = ChainFrame(stands.steps, {}, p), ChainFrame(steps, {}, p)

        def axis(unit: Sequence[float]) -> Any:
            return seen.direction(frames[0].direction(fixed.direction(vector(*unit))))

        ex = axis((1.0, 0.0, 0.0))
        loops = list(position.equations(frames, x, p))
        if measured is None:
            return [*loops, turn_between(ex[0], ex[1], x[angles[0]])]
        ey = axis((0.0, 1.0, 0.0))
        off = small_turns(measured.axes(x), (ex, ey, cross(ex, ey)))
        return loops + [w - x[angle] for w, angle in zip(off, angles, strict=True)]

    return Instrument(
        name,
        {**position.readings, **dict.fromkeys(angles, "rad")},
        {**position.parameters, **placed_by(steps, str(target))},
        equations,
        "pose",
        placement=position.placement,
        mounted=(*position.mounted, *turn_names),
        place=position.place,
        pose_constants={} if measured is None else measured.units,
        orientation=measured,
        implied={} if measured is None else dict.fromkeys(angles, 0.0),
        dimension=dimension,
    )
