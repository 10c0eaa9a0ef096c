"""What parallel machines share: joints as points, links in a plane, legs that close."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import unknown_name
from loopcal.expressions.vectors import norm, rotate, vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import zero_of
from loopcal.mechanisms.frame import BodyFrame, Values, Vector
from loopcal.mechanisms.parameters import Parameter, Role

Name = Annotated[str, Key("Name of the machine.")]
Polylines = list[list[Vector]]
"""Lines to draw a machine by, points (3,) [m] in its base frame."""


def joint_coordinates(joints: Mapping[str, Sequence[float]]) -> dict[str, Parameter]:
    """Parameters a1_x, a1_y, ... [m] from {"a1": (x, y, z)}, in a plane without z."""
    return {
        f"{name}_{axis}": Parameter(
            f"{name}_{axis}", float(value), "m", owner=name, meaning=f"position along {axis}"
        )
        for name, values in joints.items()
        for axis, value in zip("xyz", values, strict=False)
    }


def joint_names(letter: str, count: int, axes: str = "xyz") -> tuple[tuple[str, ...], ...]:
    """The coordinates of the joints a1, a2 and so on, joint by joint."""
    return tuple(tuple(f"{letter}{i}_{axis}" for axis in axes) for i in range(1, count + 1))


def in_unit(unit: str, values: Mapping[str, float]) -> dict[str, Parameter]:
    """Lengths, or turns between axes, with these nominal values [SI]."""
    role: Role = "length" if unit == "m" else "twist"
    return {name: Parameter(name, float(value), unit, role=role) for name, value in values.items()}


def joint(p: Values, name: str, dimension: int = 3) -> Vector:
    """The point (3,) of a joint, z = 0 in a plane."""
    coordinates = [p[f"{name}_{axis}"] for axis in "xyz"[:dimension]]
    return vector(*coordinates, *[0.0] * (3 - dimension))


def read(x: Values, p: Values, quantity: str) -> Any:
    """What a joint truly stands at: reading + QUANTITY_offset."""
    return x[quantity] + p[f"{quantity}_offset"]


def along(length: Any, angle: Any) -> Vector:
    """A link in the plane: length (cos angle, sin angle, 0)."""
    return rotate("z", angle, vector(length, 0.0, 0.0))


def plane_frame(cosine: Any, sine: Any, origin: Vector) -> BodyFrame:
    """A body that moves in the plane, from the direction of its x axis."""
    columns = [vector(cosine, sine, 0.0), vector(-sine, cosine, 0.0), vector(0.0, 0.0, 1.0)]
    return BodyFrame(stacked(columns), origin)


def stacked(columns: Sequence[Vector]) -> NDArray[Any]:
    """The matrix (3, 3) of these columns."""
    return np.stack(columns, axis=1)


def chosen_passive(
    passive: Iterable[str], passive_joints: Sequence[str], machine: str
) -> tuple[str, ...]:
    """The passive joints that carry a sensor, in the machine's own order.

    Raises InputError for one that the machine does not have.
    """
    wanted = tuple(passive)
    for name in wanted:
        if name not in passive_joints:
            raise unknown_name(f"{machine!r} has no passive joint {name!r}", name, passive_joints)
    return tuple(name for name in passive_joints if name in wanted)


def offsets(quantities: Mapping[str, str], nominal: float = 0.0) -> dict[str, Parameter]:
    """The zero QUANTITY_offset of each quantity, by its SI unit."""
    return {
        f"{q}_offset": Parameter(f"{q}_offset", nominal, unit).of("zero", q, zero_of(q))
        for q, unit in quantities.items()
    }


def starts(
    defaults: Mapping[str, float],
    stated: Mapping[str, float] | None,
    quantities: Iterable[str],
    machine: str,
) -> dict[str, float]:
    """Where quantities stand at home: the machine's own values, replaced by those stated.

    Raises InputError for what is no quantity of the machine.
    """
    names = tuple(quantities)
    for name in stated or {}:
        if name not in names:
            raise unknown_name(
                f"the home of {machine!r} names {name!r}, which is not one of its quantities",
                name,
                names,
            )
    return {name: value for name, value in {**defaults, **(stated or {})}.items() if name in names}


def ring(radius: float, degrees: Sequence[float]) -> list[tuple[float, float]]:
    """Points (x, y) on a circle about the origin."""
    turns = [math.radians(angle) for angle in degrees]
    return [(radius * math.cos(turn), radius * math.sin(turn)) for turn in turns]


def planar_leg(x: Values, p: Values, i: int, end: Vector, passive: Sequence[str]) -> list[Any]:
    """Loops [m] of the leg a_i - elbow - end of two links, its elbow read (phi_i) or not.

    |end - elbow| - distal_i = 0, or elbow + distal_i (cos, sin)(theta_i + phi_i) - end = 0.
    """
    from_elbow = end - elbow(x, p, i)
    if f"phi_{i}" not in passive:
        return [norm(from_elbow) - p[f"distal_{i}"]]
    angle = read(x, p, f"theta_{i}") + read(x, p, f"phi_{i}")
    return list((along(p[f"distal_{i}"], angle) - from_elbow)[:2])


def elbow(x: Values, p: Values, i: int) -> Vector:
    """The far end of the proximal link: a_i + proximal_i (cos, sin)(theta_i)."""
    return joint(p, f"a{i}", 2) + along(p[f"proximal_{i}"], read(x, p, f"theta_{i}"))


def planar_leg_names(i: int, passive: Sequence[str]) -> list[str]:
    """Names of the loops of `planar_leg`."""
    return [f"leg_{i}_x", f"leg_{i}_y"] if f"phi_{i}" in passive else [f"leg_{i}"]
