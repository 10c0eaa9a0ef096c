"""What gravity does to a chain: the generalised force of its loads on joints and parameters.

Let q be anything that moves the chain. The principle of virtual work gives the force Q on it. For
weights m_k g at the points r_k, Q = d/dq sum_k m_k g . r_k. Where q turns (slides along) the
axis a of a step, dr/dq = a x (r - o) (= a): the moment about that axis (the force along it). It
is summed over the steps that q moves, in which a mimicking joint, or a parameter used twice, has
several.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.expressions.vectors import cross, rotate, vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step, apply
from loopcal.mechanisms.frame import Values, Vector
from loopcal.mechanisms.parameters import Parameter

ACCELERATION = 9.80665
"""Standard gravity [m/s^2], 3rd CGPM (1901); the Earth's own differs by up to 0.3 %."""

Point = Annotated[
    tuple[float, float, float],
    Key("Place of the load in the frame directly behind the motion of that joint.", unit="m"),
]
Mass = Annotated[
    float | None,
    Key("Mass, for all loads or for none; without it, masses and compliance are one.", unit="kg"),
]


@dataclass(frozen=True)
class Load:
    """A point of the arm that weighs something.

    joint: the joint that it moves with; point [m]: where, in the frame directly behind that
    joint's motion, one of whose axes the joint turns about; mass [kg], None where it is not known.

    Raises InputError for a mass that is not positive.
    """

    name: Annotated[str, Key("Name of the load; ends the names of its parameters.")]
    joint: Annotated[str, Key("The joint that the load moves with.")]
    point: Point = (0.0, 0.0, 0.0)
    mass: Mass = None

    def __post_init__(self) -> None:
        if self.mass is not None and not 0.0 < self.mass < math.inf:
            raise InputError(
                f"the mass of the load {self.name!r} is {self.mass:g} kg",
                code="invalid-value",
                remedy="give a positive number, or none if unknown",
            )

    @property
    def weight(self) -> float:
        """m g [N]; 1 where the mass is unknown: force and compliance are then one parameter."""
        return 1.0 if self.mass is None else self.mass * ACCELERATION


def acting(chain: Sequence[Step], name: str) -> list[int]:
    """Positions of the steps that a joint or parameter moves."""
    return [i for i, step in enumerate(chain) if name in (step.joint, step.parameter)]


def end_of(chain: Sequence[Step], load: Load) -> int:
    """How many steps stand between the base and a load.

    Raises InputError for a joint that the chain has not.
    """
    carrying = [i for i, step in enumerate(chain) if step.joint == load.joint]
    if not carrying:
        raise InputError(
            f"the load {load.name!r} moves with {load.joint!r}, which is not a joint of the arm",
            code="unknown-name",
            remedy="name the joint that carries it",
        )
    return carrying[-1] + 1


def refuse_beyond(chain: Sequence[Step], parameters: Iterable[Parameter], load: Load) -> None:
    """Raise InputError for a load farther from its joint than the whole chain is long.

    The length is the sum of the chain's nominal lengths; a chain that slides has none.
    """
    lengths = [step for step in chain if step.motion[0] == "t"]
    if any(step.joint for step in lengths):
        return
    nominal = {p.name: p.nominal for p in parameters}
    size = sum(abs(step.amount({}, nominal)) for step in lengths)
    away = math.hypot(*load.point)
    if 0.0 < size < away:
        meant = (
            " and lies within the machine if millimetres are meant" if away <= 1e3 * size else ""
        )
        raise InputError(
            f"the load {load.name!r} lies {away:.4g} m from its joint {load.joint!r}{meant}; the "
            f"whole machine is {size:.3g} m long",
            code="implausible-readings",
            remedy='give the point in metres, or state its unit: { value = 150, unit = "mm" } or '
            'units = { length = "mm" }',
        )


def carries(chain: Sequence[Step], name: str, load: Load) -> bool:
    """Whether the load weighs on this joint or parameter: behind it, and not on its own axis."""
    end = end_of(chain, load)
    for i in acting(chain, name):
        axis, turns = "xyz".index(chain[i].motion[1]), chain[i].motion[0] == "r"
        across = [v for k, v in enumerate(load.point) if k != axis]
        if i < end and (not turns or i < end - 1 or any(across)):
            return True
    return False


def unit_forces(
    chain: Sequence[Step],
    names: Sequence[str],
    load: Load,
    down: Sequence[float],
    x: Values,
    p: Values,
) -> dict[str, Any]:
    """Q / (m g) of one load on each name: a lever [m] where it turns, a number where it slides.

    down: unit vector along which gravity pulls, in the first frame of the chain.
    """
    end = end_of(chain, load)
    pulls = _seen(chain[:end], down, x, p)
    moving = [[n for n in names if n in (s.joint, s.parameter)] for s in chain[:end]]
    forces: dict[str, Any] = dict.fromkeys(names, 0.0)
    point = vector(*load.point)
    for i in range(end - 1, -1, -1):
        step = chain[i]
        point = apply((step,), point, x, p)
        if moving[i]:
            axis = "xyz".index(step.motion[1])
            force = (cross(point, pulls[i]) if step.motion[0] == "r" else pulls[i])[axis]
        for name in moving[i]:
            # dr/dq of a step by direction * q or sign * q is that multiple of the step's own.
            weight = step.direction if step.joint == name else step.sign
            forces[name] = forces[name] + weight * force
    return forces


def _seen(chain: Sequence[Step], down: Sequence[float], x: Values, p: Values) -> list[Vector]:
    """The direction of gravity in the frame ahead of each step."""
    pull = vector(*down)
    out = []
    for step in chain:
        out.append(pull)
        if step.motion[0] == "r":
            pull = rotate(step.motion[1], -step.amount(x, p), pull)
    return out
