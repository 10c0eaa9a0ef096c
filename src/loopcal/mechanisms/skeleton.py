"""The skeleton of an arm: where its joints and its tool point are in one pose."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.chain import product
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.serial import tool_names
from loopcal.mechanisms.station import Station, Target

Array = NDArray[np.float64]


def skeleton(mechanism: Mechanism, joints: Mapping[str, float]) -> Array | None:
    """Points (k, 3), or (k, 2) of a planar arm, [m] from the first joint to the tool point.

    joints: readings [m, rad] of one pose. In the instrument's frame, with the mechanism's own
    parameters; None for mechanisms that are not arms of a known kind.
    """
    values = {p.name: p.nominal for p in mechanism.parameters}
    described = mechanism.description or {}
    if described.get("type") == "planar-two-link":
        return _planar(values, joints)
    if not mechanism.chain:
        return None
    stands = next((f.placement for f in mechanism.families if f.placement), None)
    station = stands.steps if isinstance(stands, Station) else ()
    steps = (*station, *mechanism.chain)
    tool = _looked_at(mechanism)
    T, points = np.eye(4), []
    for step in steps:
        if step.joint is not None:
            points.append(T[:3, 3])
        T = T @ product([step], joints, values)
    at = np.array([values[name] for name in tool] or [0.0, 0.0, 0.0])
    points += [T[:3, 3], T[:3, :3] @ at + T[:3, 3]]
    return np.array(points)


def _looked_at(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of the coordinates of the first instrument's target, in the body's frame."""
    if isinstance(mechanism.placement, ChainPlacement):
        return mechanism.placement.tool
    described = mechanism.description or {}
    if "instrument" not in described:
        return tool_names(described["joints"])
    targets = [entry.get("target") for entry in described["instrument"]]
    target: str | list[str] = next((t for t in targets if t), [])
    return Target.named(target).parameters if isinstance(target, str) else tuple(target)


def _planar(values: Mapping[str, float], joints: Mapping[str, float]) -> Array:
    first = joints["phi2"] + values["phi20"]
    second = first + joints["phi3"] + values["phi30"]
    base = np.array([values["xA"], values["yA"]])
    elbow = base + values["l2"] * np.array([np.cos(first), np.sin(first)])
    return np.array(
        [base, elbow, elbow + values["l3"] * np.array([np.cos(second), np.sin(second)])]
    )
