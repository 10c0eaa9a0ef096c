"""The instruments, one row each: files, JSON Schema, reference and `loopcal.instruments` follow."""

from __future__ import annotations

from loopcal.keys import by_type
from loopcal.mechanisms.instruments.camera import camera
from loopcal.mechanisms.instruments.contact import (
    ball_bar,
    contact,
    held_part,
    plane,
    socket,
    sphere,
)
from loopcal.mechanisms.instruments.inclinometer import inclinometer
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.seen_plane import seen_plane
from loopcal.mechanisms.instruments.spherical import spherical

__all__ = [
    "ball_bar",
    "camera",
    "contact",
    "distance",
    "draw_wire",
    "held_part",
    "inclinometer",
    "plane",
    "point",
    "pose",
    "relative_distance",
    "seen_plane",
    "socket",
    "sphere",
    "spherical",
]

INSTRUMENTS = by_type(globals()[name] for name in __all__)
"""By the type that files name, what makes the instrument."""
