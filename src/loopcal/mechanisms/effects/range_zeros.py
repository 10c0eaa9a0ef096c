"""Zeros of the distances that instruments read, as of a wrong constant of a prism or reflector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.mechanisms.effects.effect import Name
from loopcal.mechanisms.effects.station_scales import by_station, named, one_each
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter

SD = 0.02
"""Prior sd of a zero [m]: constants of prisms and reflectors differ by as much."""
_NEAR = 0.05
"""So near [m] no instrument reads; chosen, twice its own zeros."""
_POINTS = ("point", "pose")
"""Instruments that state points. The others that read lengths state a distance first."""


@dataclass(frozen=True)
class RangeZeros:
    """Instruments that read every distance by a constant c too long, at the origin of their frame:

        p' = p (1 - c / |p|) of a point, d' = d - c of a distance.

    Predictions are as the instrument reads.

    >>> from loopcal import motoman_ma1400, with_effects
    >>> with_effects(motoman_ma1400(), [RangeZeros()]).effects["range_zeros"]
    ('point_zero',)

    Raises InputError where nothing reads lengths from where it stands.
    """

    name: Name = "range_zeros"

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """INSTRUMENT_zero of each station, by its first instrument."""
        stations = by_station(mechanism)
        if not stations:
            raise InputError(
                f"the effect {self.name!r} is of instruments that read lengths from where they "
                "stand, and there are none",
                code="unsupported",
                remedy="remove the effect",
            )
        return one_each(stations, "zero", "m", SD, "zero of the distances")

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """None."""
        return {}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """What was read, without the zero."""
        read: dict[str, Any] = {}
        for station in by_station(mechanism):
            zero = p[named(station, "zero")]
            for family in station:
                if family.form in _POINTS:
                    names = family.readings[:3]
                    shorter = 1.0 - zero / _distance([x[q] for q in names])
                    read |= {q: x[q] * shorter for q in names}
                else:
                    read[family.readings[0]] = x[family.readings[0]] - zero
        return read


def _distance(point: list[Any]) -> Any:
    """|p|, but `_NEAR` at the origin, where predictions of a point begin: there 1 / |p| has no
    end. At 0.2 m it is |p| to 5e-7 of itself, at half a metre to 5e-11."""
    square = sum(x * x for x in point)
    share = square / _NEAR**2
    share = share * share
    return np.sqrt(square + _NEAR**2 / (1.0 + share * share))
