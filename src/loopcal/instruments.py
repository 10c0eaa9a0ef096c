"""Instruments to look at machines with: in Python what `[[instrument]]` is in mechanism files.

Each function returns an `Instrument`; `loopcal.assemble` makes a mechanism of some and a machine.
"""

from __future__ import annotations

from loopcal.mechanisms.instruments import registry
from loopcal.mechanisms.instruments.registry import *  # noqa: F403
from loopcal.mechanisms.station import Station, Target

__all__ = ["Station", "Target"]
__all__ += registry.__all__
__all__.sort()
