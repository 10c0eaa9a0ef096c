"""The effects, one row each: files, JSON Schema, reference and `loopcal.effects` follow."""

from __future__ import annotations

from loopcal.keys import by_type
from loopcal.mechanisms.effects.backlash import Backlash
from loopcal.mechanisms.effects.compliance import Compliance
from loopcal.mechanisms.effects.drift import Drift, Shift
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.effects.range_zeros import RangeZeros
from loopcal.mechanisms.effects.scale import Scale
from loopcal.mechanisms.effects.station_scales import StationScales
from loopcal.mechanisms.effects.thermal import Thermal

__all__ = [
    "Backlash",
    "Compliance",
    "Drift",
    "Harmonics",
    "RangeZeros",
    "Scale",
    "Shift",
    "StationScales",
    "Thermal",
]

EFFECTS = by_type(globals()[name] for name in __all__)
"""By the type that files name, the effect."""
