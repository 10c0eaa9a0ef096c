"""Effects beyond geometry: in Python what `[[effect]]` is in mechanism files.

Each is a frozen value; `loopcal.with_effects` puts some into a mechanism.
"""

from __future__ import annotations

from loopcal.mechanisms.effects import registry
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.effects.registry import *  # noqa: F403

__all__ = ["Load"]
__all__ += registry.__all__
__all__.sort()
