"""Machines to be looked at by instruments, in Python what the types of mechanism files are.

Each function returns a `Machine`; `loopcal.assemble` makes a mechanism of it and `instruments`.
"""

from __future__ import annotations

from loopcal.files.machines.urdf import urdf_machine as urdf
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.frame import BodyFrame
from loopcal.mechanisms.gauge import Gauge
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.linear_delta import linear_delta
from loopcal.mechanisms.parallel.rotary_delta import rotary_delta
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr
from loopcal.mechanisms.planar import planar_machine as planar_two_link
from loopcal.mechanisms.serial import serial_machine as serial

__all__ = [
    "BodyFrame",
    "Gauge",
    "ScrewJoint",
    "exponentials",
    "five_bar",
    "four_bar",
    "linear_delta",
    "planar_two_link",
    "rotary_delta",
    "serial",
    "stewart_gough",
    "three_rrr",
    "urdf",
]
