"""Contacts with things of unknown place: planes, spheres, fixed bars, balls in sockets.

Nothing is read at all: what is known is that there is no gap. Each gap is a quantity with the
implied reading 0, whose sd is that of the contact, its form and the probing. Where every reading
is such a gap or an angle no length is measured, and the size of the machine is not to be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.expressions.vectors import cross, dot, norm, vector
from loopcal.keys import Key
from loopcal.mechanisms.frame import ChainFrame, Direction, Frame, Values
from loopcal.mechanisms.instruments.length import apart
from loopcal.mechanisms.instruments.orientation import small_turns
from loopcal.mechanisms.instruments.point import AXES
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.station import Anchor, LookedAt, Name, Station, Target

Gap = Annotated[
    str | None,
    Key("Name of the gap, which is read as 0 unless the data have its column. Default: NAME_gap."),
]
Normal = Annotated[
    Sequence[float],
    Key("Nominal direction of the normal in the machine's base, of any length.", least=3, most=3),
]
Gaps = Annotated[
    Sequence[str] | None,
    Key("Names of the gaps, which are read as 0. Default: NAME_gap_x, NAME_gap_y, NAME_gap_z."),
]


@recorded
def sphere(
    name: Name = "sphere",
    *,
    gap: Gap = None,
    centre: Anchor = None,
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """The target touches a sphere of unknown place: it is NAME_radius away from the centre C.

    Loop: |T_base_body p_target - C| - NAME_radius - gap = 0 [m]. For a probe with a ball the
    target is the ball's centre. The radius is that of the sphere plus that of the ball, inside a
    bore less it. gap: its name, by default NAME_gap; centre: name of C (default: that of the
    instrument), parameters CENTRE_x, _y, _z; target: as for `point`. In a plane a circle.
    """
    fixed = Target.named(centre or name, dimension)
    return _around(name, "radius", "gap", gap, fixed, Target.of(target, dimension))


@recorded
def ball_bar(
    name: Name = "bar",
    *,
    gap: Gap = None,
    centre: Anchor = None,
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """A double ball-bar from a ball fixed in the base to one on the body, NAME_length long.

    Loop: |T_base_body p_target - C| - NAME_length - gap = 0 [m]. The length is a parameter: fix
    it where it is known, give it a prior sd where it is uncertain, or leave it free. A bar that
    measures says in `gap` by how much it is longer than that; a rigid one has none, and without
    a column it is read as 0. Names as for `sphere`.
    """
    fixed = Target.named(centre or name, dimension)
    return _around(name, "length", "length", gap, fixed, Target.of(target, dimension))


Pair = Annotated[
    tuple[str, str],
    Key("The two bodies that touch, as they are called in the tree."),
]
Radius = Annotated[
    tuple[float, float] | None,
    Key("Radii of the balls on the two bodies, where they are known.", unit="m"),
]


@recorded
def contact(
    name: Name = "contact",
    *,
    between: Pair,
    radius: Radius = None,
    gap: Gap = None,
    target: Annotated[
        str | Target | None, Key("Name of the ball's centre on the first body. Default: NAME_1.")
    ] = None,
    centre: Annotated[
        str | None, Key("Name of the ball's centre on the second body. Default: NAME_2.")
    ] = None,
    dimension: int = 3,
) -> Instrument:
    """A ball on one body touches a ball on another one, as two hands of a robot do.

    Loop: |T_second_first p_1 - p_2| - NAME_distance - gap = 0 [m], p_1 and p_2 the centres of the
    balls in their bodies. NAME_distance is the sum of the radii, known where they are stated and
    free otherwise; it is what says how large the robot is, where nothing else does. between: the
    two bodies; gap: its name, by default NAME_gap, read as 0; target, centre: names of the
    centres, parameters NAME_1_x, ... and NAME_2_x, ...
    """
    looked_at = Target.of(target or f"{name}_1", dimension)
    made = _around(
        name, "distance", "gap", gap, Target.named(centre or f"{name}_2", dimension), looked_at
    )
    away = f"{name}_distance"
    stated = Parameter(away, sum(radius or (0.0,)), "m", fixed=radius is not None)
    of = stated.of("placement", name, "distance between the centres of two balls in contact")
    parameters = {**made.parameters, away: of}
    return replace(made, parameters=parameters, on=between[0], against=between[1])


@recorded
def held_part(
    name: Name = "part",
    *,
    between: Pair,
    dimension: int = 3,
) -> Instrument:
    """One part is held by two bodies at once: they keep their place against each other.

    Loops, with T_second_first the first body as the second one sees it and T_part the constant
    place NAME_x, ..., NAME_rx of the second one in the first:

        position of T_part T_second_first - gap = 0 [m], its turn 2 tan(theta/2) u - w = 0 [rad].

    between: the two bodies. Gaps NAME_gap_x, _y, _z and turns NAME_wx, _wy, _wz are read as 0.
    """
    stands = Station(name, dimension)
    gaps = [f"{name}_gap_{axis}" for axis in AXES[:dimension]]
    turns = [f"{name}_w{axis}" for axis in AXES]

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        seen = ChainFrame(stands.steps, {}, p)
        at = seen.point(frames[0].point(vector(0.0, 0.0, 0.0)))
        ex, ey = (
            seen.direction(frames[0].direction(vector(*unit)))
            for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        )
        off = small_turns(np.eye(3).tolist(), (ex, ey, cross(ex, ey)))
        return [
            *(at[i] - x[gap] for i, gap in enumerate(gaps)),
            *(w - x[turn] for w, turn in zip(off, turns, strict=True)),
        ]

    readings = {**dict.fromkeys(gaps, "m"), **dict.fromkeys(turns, "rad")}
    return Instrument(
        name,
        readings,
        {},
        equations,
        "gap",
        placement=stands.declared,
        place=stands,
        implied=dict.fromkeys(readings, 0.0),
        dimension=dimension,
        on=between[0],
        against=between[1],
    )


def _around(
    name: str, size: str, form: str, gap: str | None, fixed: Target, looked_at: Target
) -> Instrument:
    """A target that stays at one distance from a fixed point."""
    gap_name, length = gap or f"{name}_gap", f"{name}_{size}"

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        reached = frames[0].point(looked_at.point(p))
        return [norm(reached - fixed.point(p)) - p[length] - x[gap_name]]

    return Instrument(
        name,
        {gap_name: "m"},
        {length: Parameter(length, 0.0, "m")} | looked_at.declared,
        equations,
        form,
        placement=fixed.declared,
        mounted=looked_at.parameters,
        implied={gap_name: 0.0},
        dimension=len(fixed.parameters),
        remedy=apart(fixed),
    )


@recorded
def plane(
    name: Name = "plane",
    *,
    gap: Gap = None,
    normal: Normal = (0.0, 0.0, 1.0),
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """The target touches a plane of unknown place in the machine's base; in 2D a line.

    Loop: n . T_base_body p_target - NAME_distance - gap = 0 [m]. The unit normal is
    n = cos a cos b n_0 + sin a cos b e_1 + sin b e_2. a and b are NAME_tilt_1 and NAME_tilt_2; e_1
    and e_2 are across n_0 (for n_0 = z: x and y). normal: n_0, of any length;
    gap: its name, by default NAME_gap; target: as for `point`. The distance is that of the plane
    in which the target moves: the radius of a probe's ball is part of it.

    Raises InputError for a normal without direction.
    """
    gap_name = gap or f"{name}_gap"
    looked_at = Target.of(target, dimension)
    across = Direction.near(normal, name=name, what="normal", dimension=dimension)
    away = f"{name}_distance"

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        reached = frames[0].point(looked_at.point(p))
        return [dot(across.vector(p), reached) - p[away] - x[gap_name]]

    return Instrument(
        name,
        {gap_name: "m"},
        looked_at.declared,
        equations,
        "gap",
        placement=across.declared | {away: Parameter(away, 0.0, "m")},
        mounted=looked_at.parameters,
        implied={gap_name: 0.0},
        dimension=dimension,
    )


@recorded
def socket(
    name: Name = "socket",
    *,
    gaps: Gaps = None,
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """A ball on the body sits in a socket of unknown place: the same point in many poses.

    Loops: T_base_body p_target - S - gap = 0 [m], S = (NAME_x, NAME_y, NAME_z) in the base, in a
    plane without z. gaps: their names, by default NAME_gap_x, _y, _z; target: the ball's centre,
    as for `point`.

    Raises InputError for a number of gaps that is not the dimension.
    """
    gap_names = tuple(f"{name}_gap_{a}" for a in AXES[:dimension]) if gaps is None else tuple(gaps)
    if len(gap_names) != dimension:
        raise InputError(
            f"the socket {name!r} has {len(gap_names)} gaps in a space of {dimension}",
            code="wrong-shape",
            remedy=f"name {dimension}",
        )
    fixed = Target.named(name, dimension)
    looked_at = Target.of(target, dimension)

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        off = frames[0].point(looked_at.point(p)) - fixed.point(p)
        return [off[i] - x[gap] for i, gap in enumerate(gap_names)]

    return Instrument(
        name,
        dict.fromkeys(gap_names, "m"),
        looked_at.declared,
        equations,
        "gap",
        placement=fixed.declared,
        mounted=looked_at.parameters,
        implied=dict.fromkeys(gap_names, 0.0),
        dimension=dimension,
    )
