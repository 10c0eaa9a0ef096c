"""Instruments to look at machines with, in Python what `[[instrument]]` is in mechanism files.

Each function returns an `Instrument`; `loopcal.assemble` makes a mechanism of some and a machine.
"""

from __future__ import annotations

from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.station import Station, Target

__all__ = [
    "Station",
    "Target",
    "ball_bar",
    "distance",
    "draw_wire",
    "plane",
    "point",
    "pose",
    "relative_distance",
    "socket",
    "sphere",
    "spherical",
]
