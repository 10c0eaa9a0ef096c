"""Where an instrument stands, and the point of the machine's body that it looks at.

T_station_base = Tx Ty Tz Rz Ry Rx (yaw, pitch, roll), in a plane Tx Ty Rz: six or three
parameters, named after the station. The target is a point fixed to the moving body.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.vectors import vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step, apply, product
from loopcal.mechanisms.frame import Values, Vector
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.placement import rigid, yaw_pitch_roll

Array = NDArray[np.float64]
MOTIONS = {3: ("tx", "ty", "tz", "rz", "ry", "rx"), 2: ("tx", "ty", "rz")}
_PLACES = {"t": "position along", "r": "turn about"}
_NO_JOINTS: Mapping[str, float] = {}


@dataclass(frozen=True)
class Station:
    """The place of an instrument: parameters NAME_x, NAME_y, NAME_z, NAME_rz, NAME_ry, NAME_rx.

    name None: the readings are in the machine's own base frame, and there are no parameters.
    dimension: 3, or 2 in a plane (NAME_x, NAME_y, NAME_rz).
    """

    name: str | None
    dimension: int = 3

    @property
    def steps(self) -> tuple[Step, ...]:
        """T_station_base as elementary steps."""
        if self.name is None:
            return ()
        return tuple(Step(m, f"{self.name}_{_key(m)}") for m in MOTIONS[self.dimension])

    @property
    def declared(self) -> dict[str, Parameter]:
        """The parameters, nominal 0."""
        return placed_by(self.steps, self.name or "")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.declared)

    def seen(self, p_base: Vector, parameters: Values) -> Vector:
        """Coordinates (3,) in the station's frame of a point given in the base frame."""
        return apply(self.steps, p_base, _NO_JOINTS, parameters)

    def moved(self, values: Mapping[str, float], rotation: Array, shift: Array) -> dict[str, float]:
        """The parameters of the base seen moved by p -> rotation @ p + shift."""
        d = len(shift)
        # A motion of the plane is one of space that leaves z alone.
        R, t = np.eye(3), np.zeros(3)
        R[:d, :d], t[:d] = rotation, shift
        placed = rigid(R, t) @ product(self.steps, _NO_JOINTS, values)
        turns = yaw_pitch_roll(placed[:3, :3])
        new = (*placed[: self.dimension, 3], *turns[: 1 if self.dimension == 2 else 3])
        return dict(values) | dict(zip(self.parameters, map(float, new), strict=True))

    def advice(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Nothing: a station may stand anywhere."""
        return ()


@dataclass(frozen=True)
class Target:
    """A point fixed to the moving body, by the names of its two or three coordinates there.

    name: what it is called; "" where its coordinates were named one by one.
    """

    parameters: tuple[str, ...]
    name: str = field(default="", compare=False)

    @classmethod
    def named(cls, name: str, dimension: int = 3) -> Target:
        """The point NAME_x, NAME_y, NAME_z, in a plane without z."""
        return cls(tuple(f"{name}_{axis}" for axis in "xyz"[:dimension]), name)

    @classmethod
    def of(cls, target: str | Target, dimension: int = 3) -> Target:
        """The target itself, or the point of that name."""
        return cls.named(target, dimension) if isinstance(target, str) else target

    @property
    def declared(self) -> dict[str, Parameter]:
        """The parameters, nominal 0."""
        return {
            name: Parameter(
                name, 0.0, "m", role="mounting", owner=self.name, meaning=f"position along {axis}"
            )
            for name, axis in zip(self.parameters, "xyz", strict=False)
        }

    def point(self, parameters: Values) -> Vector:
        """The point (3,) in the body's frame, z = 0 in a plane."""
        coordinates = [parameters[name] for name in self.parameters]
        return vector(*coordinates, *[0.0] * (3 - len(coordinates)))


LookedAt = Annotated[
    str | Target,
    Key(
        "Name of the point of the body: parameters TARGET_x, _y, _z. A list names the coordinates "
        "themselves."
    ),
]
StandsAt = Annotated[
    str | None,
    Key(
        "Name of the place of the instrument: six parameters STATION_x, _y, _z, _rz, _ry, _rx, in "
        "a plane STATION_x, _y, _rz. Instruments at one place have the same station. false: "
        "coordinates are those of the machine's base."
    ),
]
OwnStation = Annotated[
    str | None,
    Key(
        "Name of the place of the instrument: six parameters STATION_x, _y, _z, _rz, _ry, _rx, in "
        "a plane STATION_x, _y, _rz. Instruments at one place have the same station. Default: the "
        "name of the instrument."
    ),
]
Anchor = Annotated[
    str | None,
    Key(
        "Name of the point fixed in the machine's base: three parameters such as NAME_x, _y, _z, "
        "which need nominal values. Default: the name of the instrument."
    ),
]
Reading = Annotated[str | None, Key("Name of the reading. Default: the name of the instrument.")]
Name = Annotated[str, Key("Name of the instrument; begins the names of what is its own.")]


def pose_of(numbers: Sequence[float] | Array) -> Array:
    """Tx Ty Tz Rz Ry Rx (4, 4) of x, y, z [m] and rz, ry, rx [rad]."""
    steps = [Step(m, constant=float(v)) for m, v in zip(MOTIONS[3], numbers, strict=True)]
    return product(steps, _NO_JOINTS, {})


def placed_by(steps: Iterable[Step], owner: str) -> dict[str, Parameter]:
    """The parameters of steps that place something, nominal 0."""
    return {
        n: Parameter(
            n,
            0.0,
            s.unit,
            role="placement",
            owner=owner,
            meaning=f"{_PLACES[s.motion[0]]} {s.motion[1]}",
        )
        for s in steps
        if (n := s.parameter)
    }


def _key(motion: str) -> str:
    return motion[1] if motion[0] == "t" else motion
