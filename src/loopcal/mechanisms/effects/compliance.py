"""An arm that yields under its weight: drives, bearings and links as springs of first order.

Whatever moves the chain may yield: a joint (its gear and shaft), or a parameter of the geometry
(the tilt of an axis in its bearing, the twist of a link). It gives way in proportion to the force
of gravity on it, computed from the geometry as it is without yielding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Name, joints
from loopcal.mechanisms.effects.gravity import (
    Load,
    acting,
    carries,
    refuse_beyond,
    unit_forces,
)
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, matching

SAG_SD = {"rad": ("rad/m", 1e-2), "m": ("m", 1e-3)}
"""Lumped: unit and prior sd, of 100 kg on a joint of 1e5 N m/rad, on a slide of 1e6 N/m."""
# A joint of 1e5 N m/rad and a slide of 1e6 N/m, as in `SAG_SD`.
YIELD_SD = {"rad": ("rad/(N m)", 1e-5), "m": ("m/N", 1e-6)}

Loads = Annotated[tuple[Load, ...], Key("Points of the arm that weigh something.", least=1)]
Yielding = Annotated[
    tuple[str, ...],
    Key('Joints and parameters by names or globs; alone, "*" stands for all turning joints.'),
]
Gravity = Annotated[
    tuple[float, float, float],
    Key(
        "Direction of gravity in the base of the arm; of an arm of transitions in the frame of the "
        "instrument."
    ),
]


@dataclass(frozen=True)
class Compliance:
    """An arm that yields under its weight: q' = q + c Q(theta), Q the moment or force of gravity.

    Q acts about (or along) the axis that q moves.
    Masses known: Q = sum_k m_k g l_k, one parameter c = NAME_yield [rad/(N m) or m/N] for each
    joint or parameter that yields. Masses unknown: c m_k g is estimated as one, NAME_sag_LOAD
    [rad per metre of lever, or m], for each load that weighs on it: c and m are indistinguishable.

    loads: points with weight, see `Load`; yielding: joints and parameters by names or globs,
    alone "*" all revolute joints; gravity: direction in which it pulls, in the first frame of
    the chain: the base of the arm, or the instrument's frame for an arm whose own parameters
    hold the placement. Source of Q: virtual work, see `gravity`.

    Raises InputError without loads, for masses that are known in part, and for a direction zero.
    """

    loads: Loads
    yielding: Yielding = ("*",)
    gravity: Gravity = (0.0, 0.0, -1.0)
    name: Name = "compliance"

    def __post_init__(self) -> None:
        names = [load.name for load in self.loads]
        if not names or len({*names}) < len(names):
            raise InputError(
                f"the loads of {self.name!r} are {names}",
                code="duplicate-name",
                remedy="list the loaded points, each with a unique name",
            )
        if len({load.mass is None for load in self.loads}) > 1:
            raise InputError(
                f"{self.name!r} has masses for some loads only",
                code="conflicting-keys",
                remedy="give all masses, or none to estimate them with the compliance",
            )
        if not any(self.gravity) or not all(map(math.isfinite, self.gravity)):
            raise InputError(
                f"gravity has the direction {list(self.gravity)}",
                code="invalid-value",
                remedy="give the vector that points down, (0, 0, -1) where z points up",
            )

    @property
    def lumped(self) -> bool:
        """Whether masses are unknown."""
        return self.loads[0].mass is None

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """One for each joint or parameter that yields, lumped: for each load on it as well."""
        made: dict[str, Parameter] = {}
        for load in self.loads:
            refuse_beyond(mechanism.chain, mechanism.parameters, load)
        for name in self._yielding(mechanism):
            si = self._unit(mechanism, name)
            loads = [load for load in self.loads if carries(mechanism.chain, name, load)]
            unit, sd = (SAG_SD if self.lumped else YIELD_SD)[si]
            for parameter in self._names(name, loads):
                made[parameter] = Parameter(
                    parameter, 0.0, unit, sd, meaning=f"compliance of {name}"
                )
        return made

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """None."""
        return {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """What yields, with what it yields by."""
        chain, yielding = mechanism.chain, self._yielding(mechanism)
        norm = math.hypot(*self.gravity)
        down = [v / norm for v in self.gravity]
        new = {name: (x if name in mechanism.quantities else p)[name] for name in yielding}
        for load in self.loads:
            on = [name for name in yielding if carries(chain, name, load)]
            for name, force in unit_forces(chain, on, load, down, x, p).items():
                (parameter,) = self._names(name, [load])
                new[name] = new[name] + p[parameter] * (load.weight * force)
        return new

    def _names(self, name: str, loads: list[Load]) -> list[str]:
        if not loads:
            return []
        return [f"{name}_sag_{load.name}" for load in loads] if self.lumped else [f"{name}_yield"]

    def _unit(self, mechanism: Mechanism, name: str) -> str:
        if name in mechanism.quantities:
            return mechanism.quantities[name]
        return mechanism.parameters[name].unit

    def _yielding(self, mechanism: Mechanism) -> list[str]:
        chain = mechanism.chain
        if not chain:
            raise InputError(
                f"{mechanism.name!r} is not a chain of joints from a base to a body, so joint "
                f"loads are unknown",
                code="unsupported",
                remedy="remove the effect 'compliance'",
            )
        if self.yielding == ("*",):
            return [q for q in joints(mechanism, ("*",), "rad") if acting(chain, q)]
        movers = dict.fromkeys(n for step in chain for n in (step.joint, step.parameter) if n)
        yielding: dict[str, None] = {}
        for pattern in self.yielding:
            yielding |= dict.fromkeys(matching(pattern, movers, "joint or parameter of the chain"))
        return list(yielding)
