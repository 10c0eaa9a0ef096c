"""How many quantities of a machine of closed loops are free, and which follow from the others."""

from __future__ import annotations

from collections.abc import Iterable

from loopcal.mechanisms.mechanism import Mechanism


def moved_quantities(mechanism: Mechanism) -> list[str]:
    """What moves a machine of closed loops: joints and platform, without what instruments read."""
    aside = {*mechanism.outputs, *mechanism.disturbances, *mechanism.turns, *mechanism.implied}
    return [q for q in mechanism.tape.quantities if q not in aside]


def freedoms_of(mechanism: Mechanism) -> int:
    """How many quantities are free: each loop equation determines one of the others."""
    errors = {*mechanism.disturbances}
    quantities = [q for q in mechanism.tape.quantities if q not in errors]
    return len(quantities) - len(mechanism.tape.loops)


def beyond_freedoms(mechanism: Mechanism, names: Iterable[str]) -> list[str]:
    """Of a machine of closed loops, quantities beyond its freedoms, which follow from the others.

    Measured ones have errors, with which no loop closes.
    """
    moved = moved_quantities(mechanism)
    return [q for q in names if q in moved][freedoms_of(mechanism) :] if mechanism.home else []
