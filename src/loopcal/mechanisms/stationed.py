"""A machine that six parameters alone move, whatever its other parameters say.

Where a station holds the placement, moving the machine changes the station alone. All that is
stated in the frames of base and joints rides along: sag and its gravity, a smooth discrepancy,
compliance, gears. The seed's transitions hold the placement themselves, in the frame of the
instrument that calibrated them. To be moved, such an arm gets a station before that frame F:

    p_instrument = T_station_F p_F(q),    T_station_F = 1 where it was calibrated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

from loopcal.expressions.substitution import Named, substituted
from loopcal.expressions.tape import Tape
from loopcal.expressions.vectors import vector
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.station import Station

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
    values = {p.name: p.nominal for p in mechanism.parameters}
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
