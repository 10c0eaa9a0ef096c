"""The [[instrument]] and [[effect]] tables of a mechanism file: what they may say, and add."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from loopcal.errors import placed
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.tables import ByType, Make, built, table
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.machine import Instrument, Machine, looked_between
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.station import standing


def _effects() -> Mapping[str, Make]:
    from loopcal.mechanisms.effects.registry import EFFECTS

    return EFFECTS


Effects = tuple[
    Annotated[Any, ByType(_effects, lambda kind: table(_effects()[kind], "Effect"))], ...
]


def affected(mechanism: Mechanism, entries: Sequence[Any], scope: Scope, place: Place) -> Mechanism:
    """The mechanism with the effects of these tables.

    Raises InputError at the table that does not fit.
    """
    effects: list[Effect] = []
    mechanism = standing(mechanism, [n for e in entries for n in getattr(e, "changing", ())])
    made = mechanism
    for i, entry in enumerate(entries):
        entry_place = place.at(i)
        effects.append(_built(entry, scope, entry_place))
        with placed(entry_place, unless_stated=True):
            made = with_effects(mechanism, effects)
    return made


def needed(mechanism: Mechanism, entries: Sequence[Any], scope: Scope, place: Place) -> set[str]:
    """Names of the parameters and known constants that the effects of these tables bring."""
    made = [_built(entry, scope, place.at(i)) for i, entry in enumerate(entries)]
    brought = [{*e.parameters(mechanism), *e.pose_constants(mechanism)} for e in made]
    return set().union(*brought) - {*mechanism.pose_constants}


def _built(entry: Any, scope: Scope, place: Place) -> Any:
    return built(_effects()[entry.type], entry, scope, place)


def _instruments() -> Mapping[str, Make]:
    from loopcal.mechanisms.instruments.registry import INSTRUMENTS

    return INSTRUMENTS


Instruments = tuple[
    Annotated[Any, ByType(_instruments, lambda kind: table(_instruments()[kind], "Instrument"))],
    ...,
]
"""With none the machine has to calibrate itself by redundant sensors."""


def instruments(
    entries: Sequence[Any], machine: Machine, scope: Scope, place: Place
) -> list[Instrument]:
    """The instruments of these tables, to look at a machine.

    Raises InputError at the table that does not fit.
    """
    made: list[Instrument] = []
    for i, entry in enumerate(entries):
        at = place.at(i)
        make = _instruments()[entry.type]
        # Some are for space alone; `assemble` refuses them beside a machine in a plane.
        planar = {"dimension": 2} if machine.dimension == 2 and _of_planes(make) else {}
        one = built(make, entry, scope, at, **planar)
        with placed(at, unless_stated=True):
            looked_between(machine, one.on, one.against)
        made.append(one)
    return made


def _of_planes(make: Make) -> bool:
    return "dimension" in inspect.signature(make).parameters
