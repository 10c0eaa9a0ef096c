"""How far the joints of a machine may go, as stated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True)
class Limit:
    """Range of a joint's reading [SI]."""

    low: float
    high: float


def joint_limits(mechanism: Mechanism) -> Mapping[str, Limit]:
    """The joints of a serial arm whose limits are stated, by name."""
    listed = (mechanism.description or {}).get("joints", ())
    stated = {joint.name: getattr(joint, "limits", None) for joint in listed}
    found = {name: Limit(span[0], span[1]) for name, span in stated.items() if span is not None}
    return {q: limit for q, limit in found.items() if q in mechanism.quantities}
