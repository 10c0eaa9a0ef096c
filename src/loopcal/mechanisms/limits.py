"""How far the joints of a machine may go, as stated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from loopcal.mechanisms.mechanism import Mechanism

MOST = 1e6
"""Limits [rad, m] beyond this limit nothing: files write 1e16 or 1e308 for a joint without any."""


@dataclass(frozen=True)
class Limit:
    """Range of a joint's reading [SI]."""

    low: float
    high: float


def joint_limits(mechanism: Mechanism) -> Mapping[str, Limit]:
    """The joints of an arm or a tree whose limits are stated, by name."""
    spans = stated_limits(listed_joints(mechanism))
    limits = {name: Limit(*span) for name, span in spans.items()}
    return {q: limit for q, limit in limits.items() if q in mechanism.quantities}


def listed_joints(mechanism: Mechanism) -> list[Any]:
    """The joints that the description of a chain or a tree lists."""
    described = mechanism.description or {}
    links = {} if mechanism.tree is None else mechanism.tree.links
    bodies = [body for body in described.get("bodies", ()) if body.name in links]
    return [*described.get("joints", ()), *(body.joint for body in bodies if body.joint)]


def stated_limits(joints: Iterable[Any]) -> dict[str, tuple[float, float]]:
    """Joint -> low and high [SI] of its reading, where they are stated and limit anything."""
    stated = ((joint.name, getattr(joint, "limits", None)) for joint in joints)
    return {n: (span[0], span[1]) for n, span in stated if span and max(map(abs, span)) <= MOST}
