"""SI values in the units that people read: millimetres, degrees, microradians."""

from __future__ import annotations

import math
from collections.abc import Sequence

from loopcal.presentation.rounding import rounded_by_sd, significant
from loopcal.units import from_si

SHOWN = {"m": "mm", "rad": "deg", "m/K": "um/K", "rad/K": "urad/K"}
"""Units in which SI values are printed, because drawings and controllers use them."""
FINE = {"m": "um", "rad": "urad"}
"""Units in which sds of sensors are printed."""
NONE = "–"
ROUNDING = 1e-12
"""Without an sd, so little [m, rad] is what the arithmetic left of zero."""


def unit_shown(unit: str, *, fine: bool = False) -> str:
    """The unit in which values of an SI unit are shown; fine: sds of sensors."""
    return (FINE if fine else SHOWN).get(unit, unit)


def factor(unit: str) -> float:
    """One of the units shown, in SI."""
    return 1.0 / float(from_si(1.0, unit_shown(unit))) if unit in SHOWN else 1.0


def size(value: float | None, unit: str, digits: int = 4, *, fine: bool = False) -> str:
    """An SI value in the unit shown, without that unit."""
    if value is None:
        return NONE
    return significant(in_unit(value, unit, fine=fine), digits)


def with_unit(value: float | None, unit: str, digits: int = 3, *, fine: bool = False) -> str:
    """An SI value in the unit shown, with that unit."""
    return f"{size(value, unit, digits, fine=fine)} {unit_shown(unit, fine=fine)}"


def in_unit(value: float, unit: str, *, fine: bool = False) -> float:
    """An SI value as a number of the unit shown."""
    shown = unit_shown(unit, fine=fine)
    return value if shown == unit else float(from_si(value, shown))


def by_sd(value: float, sd: float | None, unit: str, *, sign: bool = False) -> str:
    """An SI value in the unit shown, to the digits of its sd."""
    if sd is None:
        if unit in FINE and abs(value) < ROUNDING:
            return "0"
        shown = in_unit(value, unit)
        return significant(shown, 3) if sign else rounded_by_sd(shown, math.inf)
    return rounded_by_sd(in_unit(value, unit), in_unit(sd, unit), sign=sign)


def chance(value: float | None) -> str:
    """A probability."""
    return NONE if value is None else f"{value:.2g}"


def percent(value: float | None, digits: int = 0) -> str:
    """A share, with so many decimals.

    >>> percent(0.8), percent(0.9283, 1)
    ('80 %', '92.8 %')
    """
    return NONE if value is None else f"{100.0 * value:.{digits}f} %"


def enumerated(names: Sequence[str]) -> str:
    """Names in a sentence.

    >>> enumerated(["x", "y", "z"])
    'x, y and z'
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
