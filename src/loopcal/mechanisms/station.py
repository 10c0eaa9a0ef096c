"""Where an instrument stands, and the point of the machine's body that it looks at.

T_station_base = Tx Ty Tz Rz Ry Rx (yaw, pitch, roll), in a plane Tx Ty Rz: six or three
parameters, named after the station. The target is a point fixed to the moving body.

A machine that six parameters alone move, whatever its other parameters say.

Where a station holds the placement, moving the machine changes the station alone. All that is
stated in the frames of base and joints rides along: sag and its gravity, a smooth discrepancy,
compliance, gears. The seed's transitions hold the placement themselves, in the frame of the
instrument that calibrated them. To be moved, such an arm gets a station before that frame F:

    p_instrument = T_station_F p_F(q),    T_station_F = 1 where it was calibrated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Annotated, Any

import numpy as np

from loopcal.arrays import Array
from loopcal.expressions.rewriting import Named, substituted
from loopcal.expressions.tape import Tape
from loopcal.expressions.vectors import vector
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step, apply, product
from loopcal.mechanisms.frame import Values, Vector
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters
from loopcal.mechanisms.placement import ChainPlacement, rigid, yaw_pitch_roll

MOTIONS = {3: ("tx", "ty", "tz", "rz", "ry", "rx"), 2: ("tx", "ty", "rz")}
_PLACES = {"t": "position along", "r": "turn about"}
_NO_JOINTS: Mapping[str, float] = {}


@dataclass(frozen=True)
class Station:
    """The place of an instrument: parameters NAME_x, NAME_y, NAME_z, NAME_rz, NAME_ry, NAME_rx.

    name None: the readings are in the machine's own base frame, and there are no parameters.
    dimension: 3, or 2 in a plane (NAME_x, NAME_y, NAME_rz); flat: x and y alone are read in space,
    so nothing depends on NAME_z, which is left out.
    """

    name: str | None
    dimension: int = 3
    flat: bool = False

    @property
    def steps(self) -> tuple[Step, ...]:
        """T_station_base as elementary steps."""
        if self.name is None:
            return ()
        motions = [m for m in MOTIONS[self.dimension] if not (self.flat and m == "tz")]
        return tuple(Step(m, f"{self.name}_{_key(m)}") for m in motions)

    @property
    def declared(self) -> dict[str, Parameter]:
        """The parameters, nominal 0."""
        return placed_by(self.steps, self.name or "")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(step.parameter for step in self.steps if step.parameter)

    def seen(self, p_base: Vector, parameters: Values) -> Vector:
        """Coordinates (3,) in the station's frame of a point given in the base frame."""
        return apply(self.steps, p_base, _NO_JOINTS, parameters)

    def moved(self, values: Mapping[str, float], rotation: Array, shift: Array) -> dict[str, float]:
        """The parameters of the base seen moved by p -> rotation @ p + shift, in space or, of what
        reads x and y, in their plane."""
        d = len(shift)
        # A motion of the plane is one of space that leaves z alone.
        R, t = np.eye(3), np.zeros(3)
        R[:d, :d], t[:d] = rotation, shift
        placed = rigid(R, t) @ product(self.steps, _NO_JOINTS, values)
        turns = yaw_pitch_roll(placed[:3, :3])
        shifts = placed[: 2 if self.flat else self.dimension, 3]
        new = (*shifts, *turns[: 1 if self.dimension == 2 else 3])
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


BASE = "base"
"""Name of the station that an arm of transitions gets."""


def stationed(mechanism: Mechanism, name: str = BASE) -> Mechanism:
    """The mechanism such that the parameters of its placement alone move it.

    An arm whose transitions place it gets a station NAME: six parameters more, nominally 0, behind
    the others. Other machines are returned as they are.
    """
    chain = mechanism.placement
    if not isinstance(chain, ChainPlacement) or chain.station is not None:
        return mechanism
    station, (family,) = Station(name), mechanism.families
    new = station.declared

    def seen_from(tape: Tape) -> Tape:
        """p_F - x with 0 for x, moved, less x: each loop still predicts its own coordinate."""

        def unread(x: Named, p: Named) -> tuple[Named, Named]:
            return dict.fromkeys(family.readings, 0.0), {}

        def moved(f: Named, x: Named, p: Named) -> Mapping[str, Any]:
            at = station.seen(vector(*(f[loop] for loop in family.loops)), p)
            read = zip(family.loops, at, family.readings, strict=True)
            return {loop: value - x[reading] for loop, value, reading in read}

        return substituted(tape, unread, parameters=tuple(new), loops=moved)

    described = mechanism.description
    return replace(
        mechanism.with_tape(seen_from),
        parameters=Parameters((*mechanism.parameters, *new.values())),
        placement=replace(chain, station=station, parameters=station.parameters),
        families=(replace(family, placement=station, standing=station.parameters),),
        description=None if described is None else {**described, "station": name},
    )


def standing(mechanism: Mechanism, patterns: Iterable[str]) -> Mechanism:
    """The mechanism such that names or globs may stand for the parameters of its station.

    Where they do, an arm of transitions gets a station that is held at 0: its transitions say where
    it stands, and what is added to the station along the run moves it rigidly.
    """
    names = Station(BASE).parameters
    if not any(fnmatchcase(name, pattern) for pattern in patterns for name in names):
        return mechanism
    made = stationed(mechanism)
    if made is mechanism:
        return mechanism
    return made.with_parameters(made.parameters.with_fixed(names))


def unstationed(mechanism: Mechanism) -> Mechanism:
    """The arm of transitions without its station: the geometry moved to where the station says.

    Sag and other model error keep their values, in frames that have moved: for comparisons of the
    geometry alone.
    """
    chain = mechanism.placement
    if not isinstance(chain, ChainPlacement) or chain.station is None:
        return mechanism
    gone, bare = chain.station.parameters, ChainPlacement.of(chain.steps, chain.tool)
    assert isinstance(chain.station, Station)
    assert bare is not None
    values = mechanism.parameters.nominal
    T = product(chain.station.steps, {}, values)
    (family,) = mechanism.families
    # The station at zero drops out of the loops; the geometry is moved in its place below.
    still = dict.fromkeys(gone, 0.0)
    left = replace(
        mechanism.with_tape(lambda t: substituted(t, lambda x, p: ({}, still), without=gone)),
        parameters=Parameters(tuple(p for p in mechanism.parameters if p.name not in gone)),
        placement=bare,
        families=(replace(family, placement=None, standing=()),),
        description=None,
    )
    new = bare.moved(values, T[:3, :3], T[:3, 3])
    return left.with_nominal({name: new[name] for name in left.parameters.names})
