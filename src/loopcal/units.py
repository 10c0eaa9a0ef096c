"""Units in which data enter and leave; inside, everything is SI (m, rad).

A unit has a dimension, a factor to the SI unit of that dimension and, for degC, a zero:

    value [SI] = factor * value [unit] + zero,    difference [SI] = factor * difference [unit]

Sds, steps and spans are differences. Units compose: "um/K", "rad/(N m)".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest

Value = TypeVar("Value", float, NDArray[np.float64])

_TABLE: dict[str, dict[str, float]] = {
    "length": {
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
        "um": 1e-6,
        "nm": 1e-9,
        "in": 0.0254,
    },
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": math.pi / 180,
        "gon": math.pi / 200,
        "arcmin": math.pi / 180 / 60,
        "arcsec": math.pi / 180 / 3600,
        "turn": 2 * math.pi,
    },
    "pixel": {"px": 1.0},
    "number": {"1": 1.0, "ppm": 1e-6},
    "mass": {"kg": 1.0, "g": 1e-3},
    "force": {"N": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "temperature": {"K": 1.0, "mK": 1e-3, "degC": 1.0},
}
_ZEROS = {"degC": 273.15}
_SPELLINGS = {
    "µm": "um", "μm": "um", "micron": "um", "inch": "in",
    "µrad": "urad", "μrad": "urad", "°": "deg", "degree": "deg", "degrees": "deg",
    "arcsecond": "arcsec", "arcseconds": "arcsec", "as": "arcsec", '"': "arcsec", "″": "arcsec",
    "arcminute": "arcmin", "arcminutes": "arcmin", "'": "arcmin", "′": "arcmin",
    "": "1", "-": "1", "°C": "degC", "℃": "degC",
}  # fmt: skip
SI = {dimension: next(iter(members)) for dimension, members in _TABLE.items()}


@dataclass(frozen=True)
class Unit:
    """A unit of one dimension ("length", "angle", "length per temperature", ...).

    value [SI] = factor * value [unit] + zero, and differences without the zero.
    """

    name: str
    dimension: str
    factor: float
    zero: float = 0.0

    @property
    def si(self) -> str:
        """Name of the SI unit of this dimension."""
        above, _, below = self.dimension.partition(" per ")
        return _quotient(SI[above], [SI[d] for d in below.split()])


_UNITS = {
    n: Unit(n, d, f, _ZEROS.get(n, 0.0))
    for d, members in _TABLE.items()
    for n, f in members.items()
}
_QUOTIENT = re.compile(r"([^/()]+)/(?:\(([^/()]+)\)|([^/() ]+))")


def unit(name: str) -> Unit:
    """The unit called `name`.

    >>> unit("arcseconds").dimension
    'angle'

    >>> unit("um/K").si
    'm/K'

    Raises InputError naming the nearest unit we know.
    """
    parsed = _parsed(name.strip())
    if parsed is None:
        raise InputError(
            f"unit {name!r} is not known", code="unknown-unit", remedy=nearest(name, _UNITS)
        )
    return parsed


@cache
def _parsed(key: str) -> Unit | None:
    """A unit by its name, or composed: A/B or A/(B C). A temperature in it is a difference."""
    key = _SPELLINGS.get(key, key)
    if key in _UNITS:
        return _UNITS[key]
    # A zero is of temperatures alone, so a quotient has none.
    composed = _QUOTIENT.fullmatch(key)
    if composed is None:
        return None
    above = _simple(composed[1])
    below = [_simple(part) for part in (composed[2] or composed[3]).split()]
    if above is None or not all(below):
        return None
    parts = [part for part in below if part]
    return Unit(
        _quotient(above.name, [part.name for part in parts]),
        f"{above.dimension} per {' '.join(part.dimension for part in parts)}",
        above.factor / math.prod(part.factor for part in parts),
    )


def _simple(key: str) -> Unit | None:
    key = key.strip()
    return _UNITS.get(_SPELLINGS.get(key, key)) if key else None


def _quotient(above: str, below: list[str]) -> str:
    if not below:
        return above
    return f"{above}/{below[0]}" if len(below) == 1 else f"{above}/({' '.join(below)})"


def to_si(values: Value, name: str) -> Value:
    """Values [unit `name`] as SI values; any shape. What is too large becomes infinite."""
    stated = unit(name)
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold signalling NaNs
        return values * stated.factor + stated.zero if stated.zero else values * stated.factor


def difference_to_si(values: Value, name: str) -> Value:
    """Differences, sds or spans [unit `name`] in SI; any shape."""
    with np.errstate(over="ignore", invalid="ignore"):
        return values * unit(name).factor


def from_si(values: Value, name: str) -> Value:
    """SI values in the unit `name`; any shape."""
    stated = unit(name)
    return (values - stated.zero) / stated.factor if stated.zero else values / stated.factor


def difference_from_si(values: Value, name: str) -> Value:
    """SI differences, sds or spans in the unit `name`; any shape."""
    return values / unit(name).factor


def convertible(name: str, other: str) -> bool:
    """Whether two units measure the same dimension."""
    return unit(name).dimension == unit(other).dimension
