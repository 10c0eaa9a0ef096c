"""Parallel machines for tests: how each is built, driven, and what its joints read, worked out
from the drawing by trigonometry alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.linear_delta import linear_delta
from loopcal.mechanisms.parallel.rotary_delta import rotary_delta
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr
from loopcal.mechanisms.station import Target

Array = NDArray[np.float64]
Ranges = Mapping[str, tuple[float, float]]

FOUR_BAR = {"theta_1": (-3.1, 3.1)}
FIVE_BAR = {"platform_x": (0.0, 0.25), "platform_y": (0.3, 0.5)}
THREE_RRR = {"platform_x": (-0.05, 0.05), "platform_y": (-0.05, 0.05), "platform_rz": (-0.3, 0.3)}
LINEAR_DELTA = {"platform_x": (-0.07, 0.07), "platform_y": (-0.07, 0.07), "platform_z": (0.0, 0.2)}
ROTARY_DELTA = {
    "platform_x": (-0.15, 0.15),
    "platform_y": (-0.15, 0.15),
    "platform_z": (-0.5, -0.38),
}
STEWART_GOUGH = {
    "platform_x": (-0.1, 0.1),
    "platform_y": (-0.1, 0.1),
    "platform_z": (0.6, 0.8),
    "platform_rz": (-0.4, 0.4),
    "platform_ry": (-0.3, 0.3),
    "platform_rx": (-0.3, 0.3),
}
OWN = Target(())
"""The frame of the body itself."""


@dataclass(frozen=True)
class Case:
    """A machine with its instruments, where it is driven, and how many parameters it shows."""

    machine: Callable[[], Machine]
    instruments: Callable[[], list[Instrument]]
    driven: Ranges
    identifiable: int

    def made(self) -> Mechanism:
        """The mechanism."""
        return assemble(self.machine(), self.instruments())

    def unread(self, mechanism: Mechanism) -> list[str]:
        """The platform's coordinates."""
        return [q for q in mechanism.quantities if q.startswith("platform_")]


def _planar(station: str | None = "base") -> list[Instrument]:
    return [point(readings=("x", "y"), station=station, dimension=2)]


CASES = {
    "four-bar, point": Case(four_bar, _planar, FOUR_BAR, 10),
    "four-bar, rocker read": Case(lambda: four_bar(passive=["theta_2"]), list, FOUR_BAR, 5),
    "four-bar, both read": Case(lambda: four_bar(passive=["theta_2", "phi_1"]), list, FOUR_BAR, 6),
    "five-bar, point": Case(five_bar, _planar, FIVE_BAR, 12),
    "five-bar, one elbow read": Case(lambda: five_bar(passive=["phi_1"]), list, FIVE_BAR, 7),
    "five-bar, both elbows read": Case(
        lambda: five_bar(passive=["phi_1", "phi_2"]), list, FIVE_BAR, 8
    ),
    "3-RRR, point": Case(three_rrr, _planar, THREE_RRR, 20),
    "3-RRR, pose": Case(three_rrr, lambda: [pose(dimension=2)], THREE_RRR, 21),
    "3-RRR, own pose": Case(
        three_rrr, lambda: [pose(dimension=2, station=None, target=OWN)], THREE_RRR, 21
    ),
    "3-RRR, elbows read": Case(
        lambda: three_rrr(passive=["phi_1", "phi_2", "phi_3"]), list, THREE_RRR, 17
    ),
    "linear delta, point": Case(linear_delta, lambda: [point()], LINEAR_DELTA, 18),
    "linear delta, own point": Case(linear_delta, lambda: [point(station=None)], LINEAR_DELTA, 18),
    "rotary delta, point": Case(rotary_delta, lambda: [point()], ROTARY_DELTA, 24),
    "rotary delta, own point": Case(rotary_delta, lambda: [point(station=None)], ROTARY_DELTA, 24),
    "Stewart-Gough, point": Case(stewart_gough, lambda: [point()], STEWART_GOUGH, 39),
    "Stewart-Gough, pose": Case(stewart_gough, lambda: [pose()], STEWART_GOUGH, 42),
    "Stewart-Gough, own pose": Case(
        stewart_gough, lambda: [pose(station=None, target=OWN)], STEWART_GOUGH, 42
    ),
    "Stewart-Gough, three angles": Case(
        lambda: stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"]), list, STEWART_GOUGH, 37
    ),
}


def elbow_angle(reach: Array, first: float, second: float) -> tuple[float, float]:
    """A planar two-link arm to a point: angle of the first link on the left, and the turn."""
    distance = float(np.hypot(*reach))
    inner = math.acos((first**2 + distance**2 - second**2) / (2 * first * distance))
    outer = math.acos((first**2 + second**2 - distance**2) / (2 * first * second))
    return math.atan2(reach[1], reach[0]) + inner, outer - math.pi


def planar(p: Mapping[str, float], name: str) -> Array:
    """A joint in the plane."""
    return np.array([p[f"{name}_x"], p[f"{name}_y"]])


def spatial(p: Mapping[str, float], name: str) -> Array:
    """A joint in space."""
    return np.array([p[f"{name}_{axis}"] for axis in "xyz"])


def four_bar_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Rocker and coupler at a crank angle, the assembly with the coupler above."""
    crank = x["theta_1"] + p["theta_1_offset"]
    first = planar(p, "a1") + p["crank"] * np.array([math.cos(crank), math.sin(crank)])
    angle, turn = elbow_angle(planar(p, "a2") - first, p["coupler"], p["rocker"])
    return {
        "platform_rz": angle,
        "theta_2": angle + turn + math.pi - p.get("theta_2_offset", 0.0),
        "phi_1": angle - crank - p.get("phi_1_offset", 0.0),
    }


def _arm(p: Mapping[str, float], i: int, end: Array, left: bool) -> dict[str, float]:
    reach = end - planar(p, f"a{i}")
    mirror = np.array([1.0, 1.0 if left else -1.0])
    angle, turn = elbow_angle(mirror * reach, p[f"proximal_{i}"], p[f"distal_{i}"])
    sign = 1.0 if left else -1.0
    return {
        f"theta_{i}": sign * angle - p[f"theta_{i}_offset"],
        f"phi_{i}": sign * turn - p.get(f"phi_{i}_offset", 0.0),
    }


def five_bar_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Joint angles with both elbows outside."""
    end = np.array([x["platform_x"], x["platform_y"]])
    return _arm(p, 1, end, True) | _arm(p, 2, end, False)


def three_rrr_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Joint angles with all elbows on the left."""
    c, s = math.cos(x["platform_rz"]), math.sin(x["platform_rz"])
    at = np.array([x["platform_x"], x["platform_y"]])
    found: dict[str, float] = {}
    for i in (1, 2, 3):
        found |= _arm(p, i, at + np.array([[c, -s], [s, c]]) @ planar(p, f"b{i}"), True)
    return found


def linear_delta_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Where a sphere about the platform meets the rails, the upper points."""
    end = spatial(x, "platform")
    found = {}
    for i in (1, 2, 3):
        turn = Rotation.from_euler("YX", [p[f"rail_{i}_ry"], p[f"rail_{i}_rx"]])
        along = turn.apply([0.0, 0.0, 1.0])
        foot = np.append(planar(p, f"a{i}"), 0.0)
        middle = float(along @ (end - foot))
        across = float(np.linalg.norm(end - foot - middle * along))
        found[f"slide_{i}"] = (
            middle + math.sqrt(p[f"rod_{i}"] ** 2 - across**2) - p[f"slide_{i}_offset"]
        )
    return found


def rotary_delta_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Each arm in its own plane, knees outside."""
    found = {}
    for i in (1, 2, 3):
        turn = Rotation.from_euler("ZX", [p[f"azimuth_{i}"], p[f"tilt_{i}"]])
        away = turn.inv().apply(spatial(x, "platform") - spatial(p, f"a{i}"))
        # in the arm's plane (x, -z) the rod's length is shortened by what lies across it
        rod = math.sqrt(p[f"distal_{i}"] ** 2 - away[1] ** 2)
        reach = np.array([away[0], away[2]])
        angle, _ = elbow_angle(reach, p[f"proximal_{i}"], rod)
        found[f"theta_{i}"] = -angle - p[f"theta_{i}_offset"]
    return found


def stewart_gough_readings(p: Mapping[str, float], x: Mapping[str, float]) -> dict[str, float]:
    """Leg lengths, and the angles of the first two universal joints."""
    turn = Rotation.from_euler("ZYX", [x[f"platform_r{axis}"] for axis in "zyx"])
    found = {}
    for i in range(1, 7):
        leg = spatial(x, "platform") + turn.apply(spatial(p, f"b{i}")) - spatial(p, f"a{i}")
        found[f"leg_{i}"] = float(np.linalg.norm(leg)) - p[f"leg_{i}_offset"]
        if f"alpha_{i}_offset" not in p:
            continue
        mount = Rotation.from_euler("ZY", [p[f"joint_{i}_rz"], p[f"joint_{i}_ry"]])
        along = mount.inv().apply(leg / np.linalg.norm(leg))
        # Rx(alpha) Ry(beta) z = (sin beta, -sin alpha cos beta, cos alpha cos beta)
        alpha, beta = math.atan2(-along[1], along[2]), math.asin(along[0])
        found[f"alpha_{i}"] = alpha - p[f"alpha_{i}_offset"]
        found[f"beta_{i}"] = beta - p.get(f"beta_{i}_offset", 0.0)
    return found


READINGS: dict[str, Callable[[Mapping[str, float], Mapping[str, float]], dict[str, float]]] = {
    "four-bar": four_bar_readings,
    "five-bar": five_bar_readings,
    "3-RRR": three_rrr_readings,
    "linear delta": linear_delta_readings,
    "rotary delta": rotary_delta_readings,
    "Stewart-Gough platform": stewart_gough_readings,
}
