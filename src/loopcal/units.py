"""Units in which data enter and leave; inside, everything is SI (m, rad).

A unit is a dimension and a factor to the SI unit of that dimension, nothing more:
value [SI] = factor * value [unit].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
        "arcmin": math.pi / 180 / 60,
        "arcsec": math.pi / 180 / 3600,
        "turn": 2 * math.pi,
    },
    "number": {"1": 1.0},
    "mass": {"kg": 1.0, "g": 1e-3},
    "force": {"N": 1.0},
    "time": {"s": 1.0},
    "temperature": {"K": 1.0},
    "angle per length": {"rad/m": 1.0, "mrad/m": 1e-3, "urad/m": 1e-6},
    "torsional compliance": {"rad/(N m)": 1.0, "urad/(N m)": 1e-6},
    "compliance": {"m/N": 1.0, "um/N": 1e-6},
}
_SPELLINGS = {
    "µm": "um", "μm": "um", "micron": "um", "inch": "in",
    "µrad": "urad", "μrad": "urad", "°": "deg", "degree": "deg", "degrees": "deg",
    "arcsecond": "arcsec", "arcseconds": "arcsec", "as": "arcsec", '"': "arcsec", "″": "arcsec",
    "arcminute": "arcmin", "arcminutes": "arcmin", "'": "arcmin", "′": "arcmin",
    "": "1", "-": "1",
}  # fmt: skip
SI = {dimension: next(iter(members)) for dimension, members in _TABLE.items()}


@dataclass(frozen=True)
class Unit:
    """A unit: `value [SI] = factor * value [unit]`, of one dimension ("length", "angle", ...)."""

    name: str
    dimension: str
    factor: float

    @property
    def si(self) -> str:
        """Name of the SI unit of this dimension."""
        return SI[self.dimension]


_UNITS = {n: Unit(n, d, f) for d, members in _TABLE.items() for n, f in members.items()}


def unit(name: str) -> Unit:
    """The unit called `name`.

    >>> unit("arcseconds").dimension
    'angle'

    Raises InputError naming the nearest unit we know.
    """
    key = name.strip()
    key = _SPELLINGS.get(key, key)
    if key not in _UNITS:
        raise InputError(
            f"unit {name!r} is not known", code="unknown-unit", remedy=nearest(name, _UNITS)
        )
    return _UNITS[key]


def to_si(values: Value, name: str) -> Value:
    """Values [unit `name`] as SI values; any shape. What is too large becomes infinite."""
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold signalling NaNs
        return values * unit(name).factor


def from_si(values: Value, name: str) -> Value:
    """SI values in the unit `name`; any shape."""
    return values / unit(name).factor


def convertible(name: str, other: str) -> bool:
    """Whether two units measure the same dimension."""
    return unit(name).dimension == unit(other).dimension
