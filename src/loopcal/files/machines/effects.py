"""The [[effect]] tables of a mechanism file: what they may say, and what they add."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from loopcal.errors import InputError
from loopcal.files.machines.entries import Units, any_of, built
from loopcal.files.toml.model import Model
from loopcal.files.toml.place import Place
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.effects.registry import EFFECTS
from loopcal.mechanisms.mechanism import Mechanism

if TYPE_CHECKING:
    Effects = list[Any]
else:
    Effects = Annotated[
        list[any_of(EFFECTS.values(), "Effect")],
        Field(description="What geometry does not explain; zero parameters change nothing."),
    ]


class MechanismModel(Model):
    """What mechanisms of all types may say."""

    effect: Effects = Field(default=[])


def affected(mechanism: Mechanism, entries: Sequence[Any], units: Units, place: Place) -> Mechanism:
    """The mechanism with the effects of these tables.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    effects: list[Effect] = []
    made = mechanism
    for i, entry in enumerate(entries):
        here = place.at(i)
        effects.append(built(EFFECTS[entry.type], entry, units, here))
        try:
            made = with_effects(mechanism, effects)
        except InputError as error:
            raise error if error.place else error.at(str(here)) from None
    return made


def needed(mechanism: Mechanism, entries: Sequence[Any], units: Units, place: Place) -> set[str]:
    """Names of the parameters and known constants that the effects of these tables bring."""
    made = [built(EFFECTS[e.type], e, units, place.at(i)) for i, e in enumerate(entries)]
    brought = [{*e.parameters(mechanism), *e.known(mechanism)} for e in made]
    return set().union(*brought) - {*mechanism.known}
