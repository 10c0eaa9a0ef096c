"""A model of a machine: which of its effects are switched on, and what is not estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from loopcal.errors import InputError, nearest
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True)
class Model:
    """effects: names of those switched on; fixed: parameters by names or globs, not estimated."""

    effects: Annotated[
        tuple[str, ...], Key("Names of the mechanism's effects that are switched on.")
    ] = ()
    fixed: Annotated[
        tuple[str, ...], Key("Parameters, by name or glob, that this model does not estimate.")
    ] = ()


def with_only(mechanism: Mechanism, model: Model) -> Mechanism:
    """The mechanism of a model: parameters of other effects fixed at zero, those named fixed.

    Raises InputError for an effect or parameter that is not there.
    """
    for name in model.effects:
        if name not in mechanism.effects:
            raise InputError(
                f"the mechanism has no effect {name!r}",
                code="unknown-name",
                remedy=nearest(name, mechanism.effects)
                if mechanism.effects
                else "describe it in the mechanism first: [[effect]]",
            )
    off = [
        p for name, names in mechanism.effects.items() if name not in model.effects for p in names
    ]
    parameters = mechanism.parameters.with_nominal(dict.fromkeys(off, 0.0)).with_fixed(off)
    return mechanism.with_parameters(parameters.with_fixed(model.fixed))
