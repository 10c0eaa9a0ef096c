"""The parallel machines, one row each: files, schema, drawings, `loopcal.machines` follow."""

from __future__ import annotations

from loopcal.keys import by_type
from loopcal.mechanisms.parallel.delta import linear_delta, rotary_delta
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.free_body import free_body
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr

__all__ = [
    "five_bar",
    "four_bar",
    "free_body",
    "linear_delta",
    "rotary_delta",
    "stewart_gough",
    "three_rrr",
]

PARALLEL = by_type(globals()[name] for name in __all__)
"""By the type that files name, what makes the machine."""
