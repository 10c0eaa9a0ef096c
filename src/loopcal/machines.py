"""Machines to be looked at by instruments: in Python what the types of mechanism files are.

Each function returns a `Machine`; `loopcal.assemble` makes a mechanism of it and `instruments`.
"""

from __future__ import annotations

from loopcal.files.machines.urdf import urdf_machine as urdf
from loopcal.files.machines.urdf import urdf_tree as tree
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.frame import BodyFrame
from loopcal.mechanisms.parallel import registry
from loopcal.mechanisms.parallel.registry import *  # noqa: F403
from loopcal.mechanisms.parameters import Gauge
from loopcal.mechanisms.planar import planar_machine as planar_two_link
from loopcal.mechanisms.serial import serial_machine as serial

__all__ = [
    "BodyFrame",
    "Gauge",
    "ScrewJoint",
    "exponentials",
    "planar_two_link",
    "serial",
    "tree",
    "urdf",
]
__all__ += registry.__all__
__all__.sort()
