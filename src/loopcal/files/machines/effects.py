"""The [[effect]] tables of a mechanism file: what they may say, and what they add."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field

from loopcal.errors import InputError
from loopcal.files.machines.entries import Make, Units, built, table
from loopcal.files.toml.by_type import ByType
from loopcal.files.toml.place import Place
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.mechanism import Mechanism


def _effects() -> Mapping[str, Make]:
    from loopcal.mechanisms.effects.registry import EFFECTS

    return EFFECTS


Effects = Annotated[
    list[Annotated[Any, ByType(_effects, lambda kind: table(_effects()[kind], "Effect"))]],
    Field(description="What geometry does not explain; zero parameters change nothing."),
]


def affected(mechanism: Mechanism, entries: Sequence[Any], units: Units, place: Place) -> Mechanism:
    """The mechanism with the effects of these tables.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    effects: list[Effect] = []
    made = mechanism
    for i, entry in enumerate(entries):
        here = place.at(i)
        effects.append(_built(entry, units, here))
        try:
            made = with_effects(mechanism, effects)
        except InputError as error:
            raise error if error.place else error.at(str(here)) from None
    return made


def needed(mechanism: Mechanism, entries: Sequence[Any], units: Units, place: Place) -> set[str]:
    """Names of the parameters and known constants that the effects of these tables bring."""
    made = [_built(entry, units, place.at(i)) for i, entry in enumerate(entries)]
    brought = [{*e.parameters(mechanism), *e.known(mechanism)} for e in made]
    return set().union(*brought) - {*mechanism.known}


def _built(entry: Any, units: Units, place: Place) -> Any:
    return built(_effects()[entry.type], entry, units, place)
