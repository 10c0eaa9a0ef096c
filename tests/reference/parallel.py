"""Parallel machines for tests: how each is built, driven, and what its joints read, worked out
from the drawing by trigonometry alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


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
